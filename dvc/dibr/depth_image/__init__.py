"""Depth maps, pictures with depth, and layers and sprites as such pictures: wavelets that stop at edges."""
