"""Figures of structure from motion, and of side information by the geometry of the scene."""
