"""Turbo codes: recursive convolutional codes, interleaved and punctured, decoded by iterations."""
