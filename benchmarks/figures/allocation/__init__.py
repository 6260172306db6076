"""Figures of streams whose bits pay alike, one quality for everything: the `allocation` area."""
