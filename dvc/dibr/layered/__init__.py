"""Layers and sprites of chapter 2, coded as pictures with depth and mask, and rendered."""
