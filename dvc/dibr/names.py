"""Codecs of disparities by the names that options and streams have for them."""

from dvc.extensions import DISPARITY_CODECS, Registry

EXTENSION = 4
"""Number of those whose names stand in streams."""
NUMBERS: Registry[int] = Registry(
    DISPARITY_CODECS, {"l": 0, "s": 1, "quadtree": 2, "blocks": 3}, lambda _: EXTENSION
)
"""What streams say, by name."""
OWN_NAMES = tuple(NUMBERS.own)
DEFAULT = OWN_NAMES[0]
