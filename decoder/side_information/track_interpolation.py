"""Prediction between two references that are aligned by tracked points, without a model of the scene.

A homography per reference, fitted to the points, warps both onto the frame. Block motion compensates the
remaining differences. In the method `tracks` residuals of the points correct the warps, references are
weighted by coverage and displacement, since one that is close to the camera of the frame is nearly the frame
itself, and block motion counts only if it makes the references agree.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from decoder.side_information.block_motion import (
    BLOCK_PX,
    BlockMotionInterpolation,
    compensate,
    estimate_motion,
    phase_planes,
    split_field,
)
from decoder.side_information.protocol import Interpolation, Prediction, ReferenceFrame
from decoder.side_information.synthesis import neighbourhood
from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers
from dvc.geometry.cameras import homogeneous
from dvc.geometry.warping import sample
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from sfm.decompositions import right_singular

MIN_NUM_POINTS = 12
"""Points that a homography is fitted to at least."""
MIN_AFFINE_POINTS = 6
"""Points that an affine map is fitted to at least; fewer give a translation."""
REACH_PX = 3.0
"""Largest distance of a point from its mapped position in the common motion."""
MAX_CONDITION = 16.0
"""Largest quotient of the scales of a plausible map over a frame."""


def whole_frame_motion(points: Floats, matches: Floats) -> Floats:
    """Fit the common motion of points: a homography, or fewer parameters for few points."""
    finite = np.isfinite(points).all(axis=1) & np.isfinite(matches).all(axis=1)
    first, second, translation = points[finite], matches[finite], np.eye(3)
    if not len(first):
        return translation
    translation[:2, 2] = np.median(second - first, axis=0)
    if len(first) < MIN_AFFINE_POINTS:
        return translation
    if len(first) >= MIN_NUM_POINTS:
        found, _ = cv2.findHomography(
            first, second, cv2.USAC_MAGSAC, REACH_PX, confidence=0.999, maxIters=2000
        )
        if found is not None and _is_sane(homography := np.asarray(found, dtype=np.float64), first):
            return homography
    affine, _ = cv2.estimateAffine2D(first, second, method=cv2.RANSAC, ransacReprojThreshold=REACH_PX)
    if affine is not None:
        whole = np.vstack([affine, [0.0, 0.0, 1.0]])
        if _is_sane(whole, first):
            return whole
    return translation


def _is_sane(homography: Floats, points: Floats) -> bool:
    """Return whether a map neither turns a frame over nor shrinks parts of it implausibly."""
    if not np.isfinite(homography).all():
        return False
    third = homogeneous(points) @ homography[2]
    if third.min() <= 0.0 or third.max() > MAX_CONDITION * third.min():
        return False
    scales, _ = right_singular(homography[:2, :2] / third.mean())
    turned = float(np.linalg.det(homography[:2, :2])) <= 0.0
    return not turned and scales[1] > 1.0 / MAX_CONDITION and scales[0] < MAX_CONDITION


def homography_positions(homography: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the positions of the pixels of a frame under a homography."""
    rows, columns = np.indices(shape)
    points = np.stack([columns.ravel(), rows.ravel()], axis=-1).astype(np.float64)
    image = homogeneous(points) @ homography.T
    third = np.where(np.abs(image[:, 2:]) > 1e-9, image[:, 2:], 1e-9)
    limit = 4.0 * max(shape)
    positions: Floats = np.clip(image[:, :2] / third, -limit, limit)
    return positions.reshape(*shape, 2)


def warp_frame(frame: Frame, homography: Floats) -> Frame:
    """Warp a frame."""

    def _warp(plane: Bytes, homography: Floats) -> Bytes:
        warped = sample(plane, homography_positions(homography, plane.shape))
        return np.floor(warped + 0.5).astype(np.uint8)

    luma = _warp(frame.luma, homography)
    if frame.chroma is None:
        return Frame(luma, None)
    # A chroma sample lies half a pixel right of and below its luma sample: only the scale changes.
    halved = np.diag([0.5, 0.5, 1.0]) @ homography @ np.diag([2.0, 2.0, 1.0])
    return Frame(luma, (_warp(frame.chroma[0], halved), _warp(frame.chroma[1], halved)))


def aligned_block_motion(
    around: tuple[ReferenceFrame, ReferenceFrame], instant: int, points: tuple[Floats, Floats, Floats]
) -> Prediction:
    """Predict a frame by block motion between references that tracked points have aligned with it."""
    before, at_instant, after = points
    warped = []
    for reference, matches in zip(around, (before, after), strict=True):
        homography = whole_frame_motion(at_instant, matches)
        warped.append(ReferenceFrame(reference.index, warp_frame(reference.frame, homography)))
    return BlockMotionInterpolation().predict(warped, None, [instant])[0]


class Field(NamedTuple):
    """Residuals of a correction field, and its smoothness."""

    reach_px: float  # distance beyond which a residual has no influence
    max_residual_px: float  # residuals beyond it are lost tracks, or points at a step of depth
    noise_px2: float  # squared error of residuals by the rounding of tracks


NEAR = (Field(80.0, 6.0, 0.1),)
"""Fields after a model of the scene from frames on both sides."""
WIDE_TO_NARROW = tuple(Field(reach_px, 12.0, 0.2) for reach_px in (160.0, 80.0, 40.0))
"""Fields after a homography, or a model from frames on one side."""
PRIOR = 0.3
"""Weight of a residual of zero, relative to that of a point at the same position."""
LATTICE_PX = 4
"""Distance of the nodes of a field."""
MIN_NUM_RESIDUALS = 3
"""Least number of points with residuals that can agree."""


def corrected_positions(
    positions: Floats, wanted: Floats, reference: Floats, fields: Sequence[Field]
) -> Floats:
    """Correct positions in a reference by residuals of tracks, in one field after the other."""
    for field in fields:
        residuals = track_residuals(wanted, reference, positions, field.max_residual_px)
        positions = add_correction(positions, *residuals, field)
    return positions


def track_residuals(
    wanted: Floats, reference: Floats, positions: Floats, max_residual_px: float
) -> tuple[Floats, Floats]:
    """Return points, and the difference of their tracks in a reference from the rendered positions."""
    size = np.array(positions.shape[1::-1], dtype=np.float64)
    known = np.flatnonzero(np.isfinite(np.column_stack([wanted, reference])).all(axis=1))
    known = known[((wanted[known] >= 0.0) & (wanted[known] <= size - 1.0)).all(axis=1)]
    points, there = wanted[known], reference[known]
    at = points[:, ::-1].T
    looked = [map_coordinates(positions[..., axis], at, order=1, mode="nearest") for axis in (0, 1)]
    residuals: Floats = there - np.stack(looked, axis=-1)
    near = (residuals**2).sum(axis=1) <= max_residual_px**2
    return points[near], residuals[near]


def corrected(
    rendered: Interpolation, keys: tuple[Bytes, Bytes], tracks: tuple[Floats, Floats, Floats]
) -> Interpolation:
    """Correct a rendered frame by the residuals of tracks."""
    before, wanted, after = tracks
    luma, compensated, moved = rendered.luma, [], []
    for key, there, positions, weight, old in zip(
        keys, (before, after), rendered.positions, rendered.weights, rendered.compensated, strict=True
    ):
        place = corrected_positions(positions, wanted, there, NEAR)
        change = sample(key, place) - sample(key, positions)
        luma = luma + weight * change
        compensated.append(np.clip(old + change, 0.0, 255.0))
        moved.append(place)
    return rendered._replace(
        luma=np.clip(luma, 0.0, 255.0), compensated=tuple(compensated), positions=tuple(moved)
    )


def add_correction(positions: Floats, points: Floats, residuals: Floats, field: Field) -> Floats:
    """Add the correction by residuals at scattered points, bilinear between nodes of a lattice."""
    if len(points) < MIN_NUM_RESIDUALS:
        return positions.copy()
    lattice: list[tuple[Integers, Floats, Integers]] = []  # node before each pixel, distance, node behind
    for side in positions.shape[:2]:
        first, rest = np.divmod(np.arange(side), LATTICE_PX)
        lattice.append((first, rest / LATTICE_PX, np.minimum(first + 1, -(-(side - 1) // LATTICE_PX))))
    (i, below, k), (j, right, m) = lattice
    nodes = np.empty((k[-1] + 1, m[-1] + 1, 2))
    arguments = np.ascontiguousarray(points / LATTICE_PX), np.ascontiguousarray(residuals)
    correction_field(*arguments, field.reach_px / LATTICE_PX, PRIOR, field.noise_px2, nodes)
    lines = nodes[i] + below[:, None, None] * (nodes[k] - nodes[i])
    return np.asarray(positions + (lines[:, j] + right[:, None] * (lines[:, m] - lines[:, j])))


@kernel
def correction_field(
    points: Floats, residuals: Floats, reach: float, prior: float, noise_px2: float, field: Floats
) -> None:
    """Write the correction at each node of a lattice: `field` (H, W, 2), pixels."""
    near = np.empty(points.shape[0], np.int64)
    for y in range(field.shape[0]):
        count = 0
        for n in range(points.shape[0]):
            near[count] = n
            count += abs(points[n, 1] - y) < reach
        for x in range(field.shape[1]):
            total, squares = 0.0, 0.0
            sum_x, sum_y, sum_of_squares = 0.0, 0.0, 0.0
            for k in range(count):
                n = near[k]
                dx, dy = points[n, 0] - x, points[n, 1] - y
                rest = max(1.0 - (dx * dx + dy * dy) / (reach * reach), 0.0)
                weight = rest * rest * rest
                u, v = residuals[n, 0], residuals[n, 1]
                total += weight
                squares += weight * weight
                sum_x += weight * u
                sum_y += weight * v
                sum_of_squares += weight * (u * u + v * v)
            field[y, x, 0] = 0.0
            field[y, x, 1] = 0.0
            if total <= 0.0:
                continue
            mean_x, mean_y = sum_x / total, sum_y / total
            signal = mean_x * mean_x + mean_y * mean_y
            scatter = max(sum_of_squares / total - signal, 0.0) + noise_px2
            chance = scatter * squares / (total * total)
            if signal > chance:
                share = total / (total + prior) * (1.0 - chance / signal)
                field[y, x, 0] = share * mean_x
                field[y, x, 1] = share * mean_y


DISPLACEMENT_WINDOW = 33
"""Side of the neighbourhood in which displacements are averaged, in pixels."""
MAX_DISPLACEMENT_PX = 60.0
"""Displacements beyond it count as this."""
DETAIL_WINDOW = 5
"""Side of the neighbourhood in which detail is measured, in pixels."""
BASE_ERROR = 1.5
"""Expected absolute error of a flat region that has not moved, in luma levels."""
DETAIL_ERROR = 0.25
"""Expected absolute error of a region that has not moved, relative to its detail."""
MOTION_ERROR = (0.08, 0.05)
"""Growth of both errors with the displacement, per pixel."""
UNSEEN_ERROR = 3.0
"""Factor on the error outside the coverage of the reference."""


class TrackedWarp(NamedTuple):
    """A reference, warped on to a frame."""

    luma: Floats  # warped reference; the border repeats beyond it
    positions: Floats  # position of each pixel in the reference, (x, y) in pixels; may be outside
    coverage: Floats  # 1 inside the reference, 0 outside by a pixel or more
    displacement_px: Floats  # displacement of the neighbourhood of each pixel
    # expected absolute error, in luma levels: larger with detail, with displacement, and outside
    expected_error: Floats


def warp_by_tracks(reference: Bytes, points: Floats, matches: Floats) -> TrackedWarp:
    """Warp a reference on to a frame with known points."""
    shape = reference.shape
    positions = homography_positions(whole_frame_motion(points, matches), shape)
    positions = corrected_positions(positions, points, matches, WIDE_TO_NARROW)
    luma = sample(reference, positions)
    rows, columns = np.indices(shape)
    across, down = positions[..., 0] - columns, positions[..., 1] - rows
    distance = np.minimum(np.sqrt(across * across + down * down), MAX_DISPLACEMENT_PX)
    displacement_px = uniform_filter(distance, DISPLACEMENT_WINDOW, mode="nearest")
    beyond = np.maximum(-positions, positions - (np.array(shape[::-1]) - 1)).max(axis=-1)
    coverage = np.clip(1.0 - beyond, 0.0, 1.0)
    detail = np.abs(luma - uniform_filter(luma, DETAIL_WINDOW, mode="nearest"))
    detail = uniform_filter(detail, DETAIL_WINDOW, mode="nearest")
    error = BASE_ERROR + DETAIL_ERROR * detail
    error = error + displacement_px * (MOTION_ERROR[0] + MOTION_ERROR[1] * detail)
    error = error * (1.0 + (UNSEEN_ERROR - 1.0) * (1.0 - coverage))
    return TrackedWarp(luma, positions, coverage, displacement_px, error)


METHOD = "tracks"
"""Name that its predictions carry."""
PACE_PX = 0.3
"""Displacement that counts as much as one frame of time."""
NOISE = 4.0
"""Squared error of a reference at the instant of the frame."""
USUAL_MISFIT = 1.5
"""Share of their difference that references must lose by block motion before it counts."""
MEAN_ERROR = 0.8
"""Mean absolute error relative to the root of the mean squared one."""
MIN_PACE_PX = 0.1
"""Least displacement for each frame of time in the division of block motion."""
POSITION_STEPS = 16
"""Number of steps of the temporal position that block motion gets."""
UNSEEN = 1e-6
"""Weight of a reference outside its coverage, so that the sum is never zero."""


class _Weighted(NamedTuple):
    """Weighted mean of two aligned references."""

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
    """Predict a frame between two references; by block motion if nothing better exists."""
    before, wanted, after = points
    warps = (
        warp_by_tracks(around[0].frame.luma, wanted, before),
        warp_by_tracks(around[1].frame.luma, wanted, after),
    )
    distances = instant - around[0].index, around[1].index - instant
    paces = []
    for warp, distance in zip(warps, distances, strict=True):
        squared = warp.displacement_px**2 + (PACE_PX * distance) ** 2
        paces.append(squared / np.sqrt(np.sqrt(squared)))
    first_share: Floats = paces[0] / (paces[0] + paces[1])
    shares = first_share, 1.0 - first_share  # each reference in the squared difference of both
    both = np.minimum(warps[0].coverage, warps[1].coverage)
    first, second = (warp.coverage for warp in warps)
    aligned = (  # each filled from the other one outside its coverage
        np.where((first < 1.0) & (second > first), warps[1].luma, warps[0].luma),
        np.where((second < 1.0) & (first > second), warps[0].luma, warps[1].luma),
    )
    warped = _weighted(aligned, warps, shares)
    moved = warped
    if moves:  # block motion compensates the rest, divided by the distances of the references
        paces_px = [
            float(np.median(warp.displacement_px)) + MIN_PACE_PX * distance
            for warp, distance in zip(warps, distances, strict=True)
        ]
        step = round(POSITION_STEPS * paces_px[0] / (paces_px[0] + paces_px[1]))
        position = Fraction(min(max(step, 1), POSITION_STEPS - 1), POSITION_STEPS)
        rounded = to_uint8(aligned[0]), to_uint8(aligned[1])
        field = estimate_motion(*rounded, position)
        planes, offsets = [phase_planes(luma) for luma in rounded], list(split_field(field, position))
        weights = [np.ones(field.shape[:2])] * 2
        _, lumas = compensate(planes, offsets, weights, BLOCK_PX, rounded[0].shape)
        moved = _weighted((lumas[0], lumas[1]), warps, shares)
    misfit = USUAL_MISFIT * moved.difference + NOISE
    share = np.floor(both) * np.maximum(1.0 - misfit / np.maximum(warped.difference, NOISE), 0.0)
    luma = warped.luma + share * (moved.luma - warped.luma)
    agreed = MEAN_ERROR * np.sqrt(warped.error + share * (moved.error - warped.error))
    single = np.minimum(warps[0].expected_error, warps[1].expected_error)
    error = both * agreed + (1.0 - both) * single
    limit = 2.0 * error
    compensated = tuple(luma + np.clip(warp.luma - luma, -limit, limit) for warp in warps)
    positions = tuple(warp.positions for warp in warps)
    hypotheses = (warped.luma, moved.luma) if moves else (warped.luma,)
    return Interpolation(luma, compensated, warped.weights, positions, error, hypotheses)


def _weighted(
    lumas: tuple[Floats, Floats], warps: tuple[TrackedWarp, TrackedWarp], shares: tuple[Floats, Floats]
) -> _Weighted:
    """Average two references by their coverage and by the share of each in the error of their difference."""
    difference = neighbourhood((lumas[0] - lumas[1]) ** 2)
    errors = NOISE + shares[0] * difference, NOISE + shares[1] * difference
    first, second = ((warp.coverage + UNSEEN) / error for warp, error in zip(warps, errors, strict=True))
    weights = first / (first + second), second / (first + second)
    luma = weights[0] * lumas[0] + weights[1] * lumas[1]
    error = weights[0] ** 2 * errors[0] + weights[1] ** 2 * errors[1]
    return _Weighted(luma, weights, difference, error)
