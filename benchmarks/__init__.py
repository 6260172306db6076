"""Measurements: every figure that is asked of the project, and scripts for single ones."""
