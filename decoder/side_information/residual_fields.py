"""Residuals of tracks: how far a motion misses where they are, and a smooth field of that.

Where residuals of neighbouring tracks agree, they are no chance, and what they agree on holds between them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from decoder.side_information import _kernels

Floats = NDArray[np.float64]


class Field(NamedTuple):
    """What residuals a field is made of, and how smooth it is."""

    reach_px: float  # distance from which a residual says nothing
    max_residual_px: float  # residuals beyond it are lost tracks, or points at a step of depth
    noise_px2: float  # squared error of a residual that rounded tracks make


NEAR = (Field(80.0, 6.0, 0.1),)
"""What cameras and depths of a scene that was seen from both sides leave."""
WIDE_TO_NARROW = tuple(Field(reach_px, 12.0, 0.2) for reach_px in (160.0, 80.0, 40.0))
"""What a homography leaves, or a scene that was seen from one side."""
PRIOR = 0.3
"""Weight of a residual of zero, relative to that of a point at the very place."""
LATTICE_PX = 4
"""Distance of the places where a field is computed."""
MIN_NUM_POINTS = 3
"""Points of which residuals can agree."""


def corrected_positions(
    positions: Floats, wanted: Floats, reference: Floats, fields: Sequence[Field] = NEAR
) -> Floats:
    """Add to positions in a reference what residuals of tracks agree on, in one field after the other."""
    for field in fields:
        found = track_residuals(wanted, reference, positions, field.max_residual_px)
        positions = add_correction(positions, *found, field)
    return positions


def track_residuals(
    wanted: Floats, reference: Floats, positions: Floats, max_residual_px: float
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


def add_correction(positions: Floats, points: Floats, residuals: Floats, field: Field) -> Floats:
    """Add to positions what residuals at scattered points agree on, bilinear between places of a lattice."""
    moved = positions.copy()
    if len(points) >= MIN_NUM_POINTS:
        rows, columns = (-(-(side - 1) // LATTICE_PX) + 1 for side in positions.shape[:2])
        nodes = np.empty((rows, columns, 2))
        arguments = np.ascontiguousarray(points / LATTICE_PX), np.ascontiguousarray(residuals)
        _kernels.correction_field(*arguments, field.reach_px / LATTICE_PX, PRIOR, field.noise_px2, nodes)
        _kernels.add_between_nodes(nodes, LATTICE_PX, moved)
    return moved
