"""Turbo codes for Slepian-Wolf coding of bit planes; usable on their own."""
