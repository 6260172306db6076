"""A page on loopback that shows a decoding run."""
