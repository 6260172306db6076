"""Cameras in a plane and their rectified space (2.1 to 2.12)."""
