"""Edges of depth maps: found, selected by rate and distortion, and coded as chains (chapter 4)."""
