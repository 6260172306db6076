"""Prediction between two references that tracked points alone bring into place, without a model of the scene.

Each reference is warped for itself and has its say by what it covers and by how far it has moved: one that
the camera has hardly left is nearly the frame itself. What differs between them still is left to block
motion, which counts only where it makes them agree. This serves where there is no model of the scene, and
beside the model where the scene is not static.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.block_motion.compensation import compensate, phase_planes
from decoder.side_information.block_motion.interpolation import BLOCK_PX, estimate_motion, split_field
from decoder.side_information.protocol import Interpolation, ReferenceFrame
from decoder.side_information.tracked_warp import TrackedWarp, warp_by_tracks
from decoder.side_information.weighting import neighbourhood
from dvc.wynerziv.transform import to_uint8

Floats = NDArray[np.float64]

METHOD = "tracks"
"""Name that its predictions carry."""
PACE_PX = 0.3
"""Displacement that counts as much as one frame of time."""
NOISE = 4.0
"""Squared error of a reference at the very place of the frame."""
USUAL_MISFIT = 1.5
"""Part of their difference that references must lose by block motion for it to count at all: it is made to
find what agrees."""
MEAN_ERROR = 0.8
"""Mean absolute error relative to the root of the mean squared one."""
MIN_PACE_PX = 0.1
"""Least displacement for each frame of time, where block motion is shared out."""
POSITION_STEPS = 16
"""Steps in which the place between the references is told to block motion."""
UNSEEN = 1e-6
"""Say of a reference that does not reach, so that there is one where both do not."""


class _Weighted(NamedTuple):
    """The weighted mean of two references in place."""

    luma: Floats
    weights: tuple[Floats, Floats]
    difference: Floats  # mean squared difference of the references around each pixel
    error: Floats  # expected squared error


def interpolate_by_tracks(
    around: tuple[ReferenceFrame, ReferenceFrame],
    instant: int,
    points: tuple[Floats, Floats, Floats],
    moves: bool = True,
) -> Interpolation:
    """Predict a frame between two references; with block motion, where there is nothing better."""
    before, wanted, after = points
    warps = (
        warp_by_tracks(around[0].frame.luma, wanted, before),
        warp_by_tracks(around[1].frame.luma, wanted, after),
    )
    distances = instant - around[0].index, around[1].index - instant
    shares = _error_shares(warps, distances)
    both = np.minimum(warps[0].coverage, warps[1].coverage)
    aligned = _filled(*warps), _filled(*warps[::-1])
    warped = _weighted(aligned, warps, shares)
    moved = _weighted(_block_motion(aligned, warps, distances), warps, shares) if moves else warped
    misfit = USUAL_MISFIT * moved.difference + NOISE
    share = np.floor(both) * np.maximum(1.0 - misfit / np.maximum(warped.difference, NOISE), 0.0)
    luma = warped.luma + share * (moved.luma - warped.luma)
    agreed = MEAN_ERROR * np.sqrt(warped.error + share * (moved.error - warped.error))
    alone = np.minimum(warps[0].expected_error, warps[1].expected_error)
    error = both * agreed + (1.0 - both) * alone
    limit = 2.0 * error
    compensated = tuple(luma + np.clip(warp.luma - luma, -limit, limit) for warp in warps)
    positions = tuple(warp.positions for warp in warps)
    return Interpolation(
        luma,
        compensated,
        warped.weights,
        positions,
        error,
        (warped.luma, moved.luma) if moves else (warped.luma,),
    )


def _error_shares(
    warps: tuple[TrackedWarp, TrackedWarp], distances: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Return the share of each reference in the squared difference of both."""
    paces = []
    for warp, distance in zip(warps, distances, strict=True):
        squared = warp.displacement_px**2 + (PACE_PX * distance) ** 2
        paces.append(squared / np.sqrt(np.sqrt(squared)))
    first: Floats = paces[0] / (paces[0] + paces[1])
    return first, 1.0 - first


def _filled(warp: TrackedWarp, other: TrackedWarp) -> Floats:
    """Return a warped reference; what it does not cover is the other's."""
    filled: Floats = np.where((warp.coverage < 1.0) & (other.coverage > warp.coverage), other.luma, warp.luma)
    return filled


def _weighted(
    lumas: tuple[Floats, Floats], warps: tuple[TrackedWarp, TrackedWarp], shares: tuple[Floats, Floats]
) -> _Weighted:
    """Average two references by what they cover and by the error that each has of their difference."""
    difference = neighbourhood((lumas[0] - lumas[1]) ** 2)
    errors = NOISE + shares[0] * difference, NOISE + shares[1] * difference
    first, second = ((warp.coverage + UNSEEN) / error for warp, error in zip(warps, errors, strict=True))
    weights = first / (first + second), second / (first + second)
    luma = weights[0] * lumas[0] + weights[1] * lumas[1]
    error = weights[0] ** 2 * errors[0] + weights[1] ** 2 * errors[1]
    return _Weighted(luma, weights, difference, error)


def _block_motion(
    aligned: tuple[Floats, Floats],
    warps: tuple[TrackedWarp, TrackedWarp],
    distances: tuple[int, int],
) -> tuple[Floats, Floats]:
    """Compensate what is left of the motion: the farther a reference is, the more of it is that one's."""
    paces = [
        float(np.median(warp.displacement_px)) + MIN_PACE_PX * distance
        for warp, distance in zip(warps, distances, strict=True)
    ]
    step = round(POSITION_STEPS * paces[0] / (paces[0] + paces[1]))
    position = Fraction(min(max(step, 1), POSITION_STEPS - 1), POSITION_STEPS)
    first, second = to_uint8(aligned[0]), to_uint8(aligned[1])
    field = estimate_motion(first, second, position)
    weights = [np.ones(field.shape[:2])] * 2
    planes = [phase_planes(first), phase_planes(second)]
    offsets = list(split_field(field, position))
    _, compensated = compensate(planes, offsets, weights, BLOCK_PX, first.shape)
    return compensated[0], compensated[1]
