"""Wyner-Ziv coding of frames in the transform domain."""
