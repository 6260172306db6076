"""Figures of tracked coding: the `tracks` area."""
