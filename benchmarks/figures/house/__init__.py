"""Figures of the house itself: its size, its arrows, its speed, and what its streams decode to."""
