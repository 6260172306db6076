"""Edges of depth maps: found, selected by what they pay, and coded as chains (chapter 4)."""
