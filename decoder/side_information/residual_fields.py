"""Residuals of tracks: how far a motion misses where they are, and a smooth field of that.

Where residuals of neighbouring tracks agree, they are no chance, and what they agree on holds between them.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from decoder.side_information import _kernels

Floats = NDArray[np.float64]

REACH_PX = 80.0
"""Distance from which a residual says nothing."""
PRIOR = 0.3
"""Weight of a residual of zero, relative to that of a point at the very place."""
NOISE_PX2 = 0.1
"""Squared error of a residual that rounded tracks make."""
MAX_RESIDUAL_PX = 6.0
"""Residuals beyond it are lost tracks, or points at a step of depth."""
MIN_NUM_POINTS = 3
"""Points of which residuals can agree."""


def track_residuals(
    wanted: Floats, reference: Floats, positions: Floats, max_residual_px: float = MAX_RESIDUAL_PX
) -> tuple[Floats, Floats]:
    """Compare where tracks are in a reference with where a rendered frame looks for them."""
    size = np.array(positions.shape[1::-1], dtype=np.float64)
    known = np.flatnonzero(np.isfinite(np.column_stack([wanted, reference])).all(axis=1))
    known = known[((wanted[known] >= 0.0) & (wanted[known] <= size - 1.0)).all(axis=1)]
    points, there = wanted[known], reference[known]
    at = points[:, ::-1].T
    looked = [map_coordinates(positions[..., axis], at, order=1, mode="nearest") for axis in (0, 1)]
    residuals: Floats = there - np.stack(looked, axis=-1)
    near = (residuals**2).sum(axis=1) <= max_residual_px**2
    return points[near], residuals[near]


def correction_field(
    points: Floats,
    residuals: Floats,
    shape: tuple[int, ...],
    reach_px: float = REACH_PX,
    noise_px2: float = NOISE_PX2,
) -> Floats:
    """Spread residuals over a frame, as far as they agree."""
    field = np.zeros((shape[0], shape[1], 2))
    if len(points) >= MIN_NUM_POINTS:
        arguments = np.ascontiguousarray(points), np.ascontiguousarray(residuals)
        _kernels.correction_field(*arguments, reach_px, PRIOR, noise_px2, field)
    return field
