"""Searches for parameters that the code holds as tables."""
