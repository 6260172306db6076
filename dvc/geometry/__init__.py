"""Geometry of several views of a static scene: equations without policy."""
