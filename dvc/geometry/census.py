"""Census bits: how each pixel compares with its neighbours; no change of exposure alters them.

References
----------
[ZabihWoodfill1994] R. Zabih, J. Woodfill, "Non-parametric local transforms for computing visual
correspondence", ECCV, 1994.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels

CENSUS_RADIUS_PX = 2
DEAD_ZONE = 0.5
"""Levels by which a neighbour must be darker for its bit, so that none is set by rounding in flat places."""


def census_bits(grey: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Compare each pixel with those around it."""
    bits = np.empty(grey.shape, np.uint32)
    padded = np.pad(grey, CENSUS_RADIUS_PX, mode="edge")
    _kernels.census(padded, CENSUS_RADIUS_PX, np.float32(DEAD_ZONE), bits)
    return bits
