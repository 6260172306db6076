"""Codecs of disparities by the names that options and streams have for them."""

NUMBERS = {"l": 0, "s": 1, "quadtree": 2, "blocks": 3}
"""Numbers in streams, by name."""
OWN_NAMES = tuple(NUMBERS)
DEFAULT = OWN_NAMES[0]
