"""Slepian-Wolf coding of bit planes by parities of ranges that the decoder chooses."""
