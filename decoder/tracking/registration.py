"""What the motion of a whole frame has in common: how far all points are from even motion.

A camera that is held by hand is as far from its even path as all points of the frame agree that it is. So
this is found first, with no regard to which point is which: the difference from the predicted to the received
points that occurs most often is a shift of the frame. An affine map of the place and of the motion of a point
then turns, zooms and hurries or delays the frame.

References
----------
[Maitre2008] Sec. 5.4.2; the common deviation of a frame is an addition.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from sfm.normal_equations import solve_damped

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

NUM_TERMS = 5
"""Terms of the affine map: a constant, x and y of the place, x and y of the motion."""


@dataclass(frozen=True)
class RegistrationSettings:
    """How the common deviation of a frame is found.

    Attributes
    ----------
    range_px : int
        Largest shift that is looked for.
    blur_px : float
        Standard deviation of the window under which equal differences are counted.
    pace : float
        How much of the motion between the key frames a frame may be ahead or behind.
    pace_step_px : float
        Paces that move half of the points less than this, relative to the others, are not told apart.
    num_candidates : int
        Shifts that are considered for each frame.
    jitter_px : float
        Change of the shift from a frame to the next that costs `jitter_cost`.
    jitter_cost : float
        In standard deviations of the counts of chance.
    radii_px : tuple of float
        Distances up to which points are matched, from one step of the registration to the next.
    distance_px : float
        From here on the weight of a match decreases as the square of its distance.
    prior_px : float
        Standard deviation of each term of the affine map but the shift, where it is largest.
    """

    range_px: int = 24
    blur_px: float = 1.5
    pace: float = 0.3
    pace_step_px: float = 2.0
    num_candidates: int = 6
    jitter_px: float = 8.0
    jitter_cost: float = 1.0
    radii_px: tuple[float, ...] = (8.0, 6.0, 5.0, 4.0, 3.0, 3.0, 2.5, 2.5)
    distance_px: float = 1.0
    prior_px: float = 8.0


def mutual_matches(predicted: Floats, received: Floats, radius_px: float) -> tuple[Indices, Indices, Floats]:
    """Match predicted and received points that are nearest to each other.

    Parameters
    ----------
    predicted : ndarray of shape (N, 2), float64
        Where points should be.
    received : ndarray of shape (M, 2), float64
        Where corners are.
    radius_px : float
        Largest distance.

    Returns
    -------
    chosen, found : ndarray of shape (K,), int64
        Indices of the predicted points, in order, and of the received points that belong to them.
    distance_px : ndarray of shape (K,), float64
        Distance of each pair.
    """
    if not len(predicted) or not len(received):
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    offset = predicted[:, None] - received[None]
    squared = offset[..., 0] ** 2 + offset[..., 1] ** 2
    nearest = squared.argmin(axis=1)
    rows = np.arange(len(predicted))
    keep = (squared.argmin(axis=0)[nearest] == rows) & (squared[rows, nearest] <= radius_px**2)
    return rows[keep], nearest[keep], np.sqrt(squared[rows[keep], nearest[keep]])


def affine_terms(first: Floats, second: Floats) -> Floats:
    """Return what the deviation of a point from even motion is linear in.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        The points in the key frames, in pixels; at least one.

    Returns
    -------
    ndarray of shape (N, 5), float64
        A constant, the place between the key frames, and the motion, both about -1 to 1; motions that
        hardly differ are left out as 0.
    """
    place, motion = 0.5 * (first + second), second - first
    place = place - np.median(place, axis=0)
    motion = motion - np.median(motion, axis=0)
    reach = max(float(np.abs(place).max()), 1.0)
    spread = max(float(np.quantile(np.abs(motion), 0.9)), 1.0)
    return np.column_stack([np.ones(len(first)), place / reach, np.clip(motion / spread, -2.0, 2.0)])


def register(
    first: Floats, second: Floats, frames: list[Floats], settings: RegistrationSettings
) -> list[Floats]:
    """Find how far points are from even motion in each frame, as an affine map of place and motion.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Corresponding points of the key frames, in pixels; at least one.
    frames : list of ndarray of shape (M, 2), float64
        Points received for each frame between them.
    settings : RegistrationSettings
        How they are found.

    Returns
    -------
    list of ndarray of shape (N, 2), float64
        Deviation of each point in each frame; 0 where nothing was received.
    """
    terms = affine_terms(first, second)
    late = np.arange(1, len(frames) + 1) / (len(frames) + 1)
    even = [(1.0 - t) * first + t * second for t in late]
    starts = _common_shifts(first, second, even, frames, settings)
    return [
        _refined(terms, predicted, received, start, settings)
        for predicted, received, start in zip(even, frames, starts, strict=True)
    ]


def _refined(
    terms: Floats, predicted: Floats, received: Floats, start: Floats, settings: RegistrationSettings
) -> Floats:
    """Fit the affine map to mutually nearest points, closer and closer."""
    deviation = start
    ridge = np.diag([0.0, *[settings.prior_px**-2] * (NUM_TERMS - 1)])
    for radius in settings.radii_px:
        chosen, found, distance = mutual_matches(predicted + deviation, received, radius)
        if len(chosen) < NUM_TERMS + 1:
            break
        weight = 1.0 / (distance**2 + settings.distance_px**2)
        target = received[found] - predicted[chosen]
        shift = (weight[:, None] * target).sum(axis=0) / weight.sum()
        normal = np.einsum("n,ni,nj->ij", weight, terms[chosen], terms[chosen]) + ridge
        slope = np.einsum("n,ni,nk->ik", weight, terms[chosen], target - shift)
        fitted = [solve_damped(normal, slope[:, axis], 1e-9) for axis in (0, 1)]
        deviation = shift + np.column_stack([(terms * values).sum(axis=1) for values in fitted])
    return deviation


class _Candidate(NamedTuple):
    """A shift of a frame, how far it is ahead of even motion, and how many points agree with it."""

    shift: Floats
    pace: float
    score: float


def _common_shifts(
    first: Floats, second: Floats, even: list[Floats], frames: list[Floats], settings: RegistrationSettings
) -> list[Floats]:
    """Choose the path of shifts that most points agree with, and that changes least: a shortest path."""
    motion = second - first
    relative = motion - np.median(motion, axis=0)
    spread = float(np.quantile(np.hypot(relative[:, 0], relative[:, 1]), 0.75))
    num_paces = int(np.clip(np.floor(settings.pace * spread / settings.pace_step_px), 0, 4))
    paces = settings.pace * np.arange(-num_paces, num_paces + 1) / max(num_paces, 1)
    candidates = [
        _candidates(predicted, relative, received, paces, settings)
        for predicted, received in zip(even, frames, strict=True)
    ]
    chosen = _best_path(candidates, settings)
    return [found.shift + found.pace * relative for found in chosen]


def _candidates(
    predicted: Floats, motion: Floats, received: Floats, paces: Floats, settings: RegistrationSettings
) -> list[_Candidate]:
    """Count equal differences from predicted to received points, and return those that stand out."""
    still = [_Candidate(np.zeros(2), 0.0, 0.0)]
    if not len(received):
        return still
    found = []
    for pace in paces:
        counts = _counts(predicted + pace * motion, received, settings)
        scores = (counts - counts.mean()) / max(float(np.sqrt(counts.mean())), 1e-3)
        peaks = np.argwhere((counts == maximum_filter(counts, size=5)) & (counts > 0))
        best = np.argsort(-scores[peaks[:, 0], peaks[:, 1]], kind="stable")[: settings.num_candidates]
        for row, column in peaks[best]:
            shift = np.array([column, row], dtype=np.float64) - settings.range_px
            found.append(_Candidate(shift, float(pace), float(scores[row, column])))
    found.sort(key=lambda candidate: (-candidate.score, abs(candidate.pace)))
    return found[: settings.num_candidates] or still


def _counts(predicted: Floats, received: Floats, settings: RegistrationSettings) -> Floats:
    """Histogram of the differences within the range, blurred: rows are y, columns x."""
    reach, size = settings.range_px, 2 * settings.range_px + 1
    offset = np.rint(received[None] - predicted[:, None]).astype(np.int64).reshape(-1, 2) + reach
    near = np.logical_and(offset >= 0, offset < size).all(axis=1)
    cells = offset[near, 1] * size + offset[near, 0]
    counts = np.bincount(cells, minlength=size * size).reshape(size, size).astype(np.float64)
    blurred: Floats = gaussian_filter(counts, settings.blur_px, mode="nearest")
    return blurred


def _best_path(candidates: list[list[_Candidate]], settings: RegistrationSettings) -> list[_Candidate]:
    """Take one candidate of each frame (Viterbi); the key frames at both ends are not shifted."""
    end = [_Candidate(np.zeros(2), 0.0, 0.0)]
    stages = [end, *candidates, end]
    total, back = np.zeros(1), []
    for before, after in pairwise(stages):
        step = np.array([b.shift for b in after])[:, None] - np.array([a.shift for a in before])[None]
        cost = total[None] + settings.jitter_cost * (step**2).sum(axis=2) / settings.jitter_px**2
        back.append(cost.argmin(axis=1))
        total = cost.min(axis=1) - np.array([candidate.score for candidate in after])
    path, at = [], 0
    for stage, origin in zip(stages[::-1], back[::-1], strict=False):
        path.append(stage[at])
        at = int(origin[at])
    return path[:0:-1]
