"""Test material: rendered scenes with exact geometry, and the catalogue of named sequences."""
