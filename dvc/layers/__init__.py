"""Surfaces in one frame: layered depth images and sprites with depth (2.21, 2.22)."""
