"""Fusion of depth maps: a frame takes over what other frames have found, by vote and by expected error.

Depth maps of other frames are drawn into a frame, and are candidates beside its own. What soon leaves a frame
is so known from where it was in sight for long, and noise is averaged.

References
----------
[Merrell2007] P. Merrell et al., "Real-time visibility-based fusion of depth maps", ICCV 2007.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.depth_maps import MIN_CONFIDENCE, discontinuities
from dvc.geometry.rendering import draw
from dvc.geometry.warping import EMPTY, inverse_warp, warp_grid

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

TOLERANCE = 2.0
"""Candidates agree that differ by no more than this times the larger of their expected errors."""
MIN_VOTES = 2
"""Candidates that must agree where the frame itself is not sure."""


class SweptDepth(NamedTuple):
    """What a sweep has found of a frame."""

    inverse_depth: Floats  # of every pixel
    confidence: Floats
    error: float  # expected error of the inverse depth

    @property
    def confident(self) -> Mask:
        """Where noise would not have done the same."""
        confident: Mask = self.confidence >= MIN_CONFIDENCE
        return confident


class Candidate(NamedTuple):
    """Inverse depth of the pixels of a frame, nan where there is none, and its expected error."""

    inverse_depth: Floats
    error: Floats


def drawn_candidate(other: SweptDepth, warp: Floats) -> Candidate:
    """Draw what another frame is confident of into a frame, by the warp from that one to this one."""
    doubtful = ~other.confident
    cells = doubtful[:-1, :-1] | doubtful[:-1, 1:] | doubtful[1:, :-1] | doubtful[1:, 1:]
    nearest = np.full(doubtful.shape, EMPTY)
    draw(other.inverse_depth, warp, discontinuities(other.inverse_depth, warp), ~cells, nearest)
    seen = nearest > EMPTY
    there = warp_grid(inverse_warp(warp), np.where(seen, nearest, 0.0))[..., 2]
    # An error of the inverse depth r is one of the depth, times r squared; depth has the same in both frames.
    near = seen & (there > 0.0)
    growth = np.square(np.where(near, nearest, 1.0) / np.where(near, there, 1.0))
    return Candidate(np.where(seen, nearest, np.nan), other.error * growth)


def fused_depth(
    own: SweptDepth, others: Sequence[Candidate], consistent: Mask
) -> tuple[Floats, NDArray[np.int64]]:
    """Fuse the depth of a frame with candidates; return inverse depth, and how many agree on it.

    Where the depth is consistent already it stays, but for the mean with what agrees with it; elsewhere what
    most candidates agree on takes its place, if there are enough of them.
    """
    error = np.full(consistent.shape, own.error)
    mine = Candidate(np.where(consistent | own.confident, own.inverse_depth, np.nan), error)
    candidates = [mine, *others]
    best, votes, doubt = _mean_of_agreeing(mine, candidates)
    for each in others:
        mean, number, variance = _mean_of_agreeing(each, candidates)
        better = ~consistent & ((number > votes) | ((number == votes) & (variance < doubt)))
        best, votes = np.where(better, mean, best), np.where(better, number, votes)
        doubt = np.where(better, variance, doubt)
    usable = consistent | (votes >= MIN_VOTES)
    return np.where(usable, best, own.inverse_depth), votes


def _mean_of_agreeing(
    about: Candidate, candidates: Sequence[Candidate]
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Average what agrees with a candidate by expected error; return its number and variance, too."""
    total, mean = np.zeros(about.error.shape), np.zeros(about.error.shape)
    number = np.zeros(about.error.shape, np.int64)
    for each in candidates:
        reach = TOLERANCE * np.maximum(about.error, each.error)
        agrees = np.abs(each.inverse_depth - about.inverse_depth) <= reach  # nan: it does not
        weight = np.where(agrees, 1.0 / np.square(each.error), 0.0)
        total += weight
        mean += weight * np.where(agrees, each.inverse_depth, 0.0)
        number += agrees
    known = np.where(number > 0, total, 1.0)
    return mean / known, number, 1.0 / known
