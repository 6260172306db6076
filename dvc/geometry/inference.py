"""Inference of one hypothesis for every pixel from their costs, smooth but for discontinuities.

References
----------
[Hirschmuller2008] H. Hirschmuller, "Stereo processing by semiglobal matching and mutual information", IEEE
Trans. Pattern Anal. Mach. Intell. 30(2), 2008.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels

Floats = NDArray[np.float64]

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
UNREACHED = 20000
"""Cost of what lies before the first and after the last hypothesis: above all sums of a path, below 2^15."""


def semi_global(
    cost: NDArray[np.int16], guide: NDArray[np.uint8], small_jump: int, large_jump: int
) -> tuple[Floats, Floats]:
    """Choose hypotheses with small cost and few jumps, by dynamic programming along eight scanlines."""
    columns, count = cost.shape[1:]
    total = np.zeros(cost.shape, np.int16)
    levels, jumps = guide.astype(np.float32), (small_jump, large_jump)
    for direction in DIRECTIONS:
        lines = np.full((2, columns, count + 3), UNREACHED, np.int16)
        _kernels.aggregate_path(cost, levels, direction, jumps, (lines[0], lines[1]), total)
    hypothesis, confidence = np.empty(cost.shape[:2]), np.empty(cost.shape[:2])
    _kernels.best_hypothesis(total, hypothesis, confidence)
    return hypothesis, confidence
