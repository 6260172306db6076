"""Surfaces of all cameras: costs, occupancy, visibility, and the loop over them (2.13 to 2.20)."""
