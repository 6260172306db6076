"""Edges that are worth their bits, chosen by what they change in a transform (chapter 4, its future work)."""
