"""Compiled loops of the coding of point tracks by regression."""
