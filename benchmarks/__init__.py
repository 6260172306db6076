"""Measurements and pictures of the codec, and a demonstration."""
