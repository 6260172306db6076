"""A reference brought into the place of a frame by tracked points alone, without a model of the scene.

A homography takes the common motion, smooth fields of the residuals of the tracks take what is left of it,
such as the parallax of a slanted ground. Each reference is warped for itself, so that one serves as well as
two; how far it reaches, and how wrong it may be where it does, is told for every pixel.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from decoder.side_information.block_motion.alignment import homography_positions, whole_frame_motion
from decoder.side_information.residual_fields import WIDE_TO_NARROW, corrected_positions
from dvc.geometry.sampling import sample

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

DISPLACEMENT_WINDOW = 33
"""Side of the neighbourhood in which displacements are averaged, in pixels."""
MAX_DISPLACEMENT_PX = 60.0
"""Displacements beyond it count as this."""
DETAIL_WINDOW = 5
"""Side of the neighbourhood in which detail is measured, in pixels."""
BASE_ERROR = 1.5
"""Expected absolute error of a flat region that has not moved, in luma levels."""
DETAIL_ERROR = 0.25
"""Of one that has not moved, relative to its detail."""
MOTION_ERROR = (0.08, 0.05)
"""Growth of either with the displacement, per pixel."""
UNSEEN_ERROR = 3.0
"""How many times larger the error is where the reference does not reach."""


class TrackedWarp(NamedTuple):
    """What a reference says of a frame."""

    luma: Floats  # warped reference; the border repeats beyond it
    positions: Floats  # where each pixel lies in the reference, (x, y) in pixels; may be outside
    coverage: Floats  # 1 where that is inside the reference, 0 where it is outside by a pixel or more
    displacement_px: Floats  # how far the neighbourhood of each pixel has moved
    # expected absolute error, in luma levels: larger where there is detail, where much has moved, and outside
    expected_error: Floats


def warp_by_tracks(reference: Luma, points: Floats, matches: Floats) -> TrackedWarp:
    """Warp a reference on to a frame, of which only points are known."""
    shape = reference.shape
    positions = homography_positions(whole_frame_motion(points, matches), shape)
    positions = corrected_positions(positions, points, matches, WIDE_TO_NARROW)
    luma, moved = sample(reference, positions), _displacement(positions)
    inside = _coverage(positions)
    return TrackedWarp(luma, positions, inside, moved, _expected_error(luma, inside, moved))


def _displacement(positions: Floats) -> Floats:
    rows, columns = np.indices(positions.shape[:2])
    across, down = positions[..., 0] - columns, positions[..., 1] - rows
    distance = np.minimum(np.sqrt(across * across + down * down), MAX_DISPLACEMENT_PX)
    mean: Floats = uniform_filter(distance, DISPLACEMENT_WINDOW, mode="nearest")
    return mean


def _coverage(positions: Floats) -> Floats:
    size = np.array(positions.shape[1::-1])
    beyond = np.maximum(-positions, positions - (size - 1)).max(axis=-1)
    inside: Floats = np.clip(1.0 - beyond, 0.0, 1.0)
    return inside


def _expected_error(luma: Floats, coverage: Floats, displacement_px: Floats) -> Floats:
    side = DETAIL_WINDOW
    detail = np.abs(luma - uniform_filter(luma, side, mode="nearest"))
    detail = uniform_filter(detail, side, mode="nearest")
    still = BASE_ERROR + DETAIL_ERROR * detail
    moved = displacement_px * (MOTION_ERROR[0] + MOTION_ERROR[1] * detail)
    error: Floats = (still + moved) * (1.0 + (UNSEEN_ERROR - 1.0) * (1.0 - coverage))
    return error
