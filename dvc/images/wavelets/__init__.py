"""Wavelet transforms of planes of any size."""
