"""Corners of the key frames that are likely to be found in the frames between as well.

A detector does not find the very point that correspondences were found for, but the strongest response near
it, a pixel or so away; and it does so in every frame. So the curve that is followed is that of the corner,
which begins and ends where the key frames' response is strongest, and what is said of a track in the end is
where the point itself must be.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.corners import SENT_WINDOW_PX, corner_response, spaced
from sfm.model import Correspondences

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

SEARCH_RADIUS_PX = 2
"""How far a corner may be from its point, by rows and by columns."""

MAX_DRIFT_PX = 1.5
"""A corner whose place relative to its point changes more than this is no corner of the scene."""


class PairedCorners(NamedTuple):
    """Correspondences, and the corners beside them."""

    pairs: Correspondences  # the points, in pixels
    first: Floats  # the strongest response of the detector at each point, in the key frames
    second: Floats

    def __len__(self) -> int:
        """Return the number of corners."""
        return len(self.pairs)

    def corners(self, temporal_positions: Floats) -> Floats:
        """Move the corners evenly from key frame to key frame."""
        return _evenly(self.first, self.second, temporal_positions)

    def offsets(self, temporal_positions: Floats) -> Floats:
        """Return how far the corners are from their points."""
        return _evenly(self.first - self.pairs.first, self.second - self.pairs.second, temporal_positions)


def _evenly(first: Floats, second: Floats, temporal_positions: Floats) -> Floats:
    t = temporal_positions[None, :, None]
    return (1.0 - t) * first[:, None] + t * second[:, None]


def choose_paired_corners(
    pairs: Correspondences, first: Luma, second: Luma, num_corners: int, separation_px: float
) -> PairedCorners:
    """Choose correspondences that are corners in both key frames, the strongest first, spread out."""
    ends = [
        strongest_nearby(corner_response(luma, np.ones(SENT_WINDOW_PX)), places, SEARCH_RADIUS_PX)
        for luma, places in ((first, pairs.first), (second, pairs.second))
    ]
    (corner0, strength0), (corner1, strength1) = ends
    drift = (corner0 - pairs.first) - (corner1 - pairs.second)
    strength = np.minimum(strength0, strength1)
    usable = np.flatnonzero((strength > 0) & (np.hypot(drift[:, 0], drift[:, 1]) < MAX_DRIFT_PX))
    # Of points that share a corner the one that is nearest to it comes first.
    distance = np.hypot(*(corner0 - pairs.first)[usable].T) + np.hypot(*(corner1 - pairs.second)[usable].T)
    order = usable[np.lexsort((distance, -strength[usable]))]
    chosen = order[spaced(corner0[order], num_corners, separation_px)]
    return PairedCorners(pairs[chosen], corner0[chosen], corner1[chosen])


def strongest_nearby(response: Floats, places: Floats, radius: int) -> tuple[Floats, Floats]:
    """Find the peak of a response at places, between pixels."""
    steps = np.arange(-radius, radius + 1)
    padded = np.pad(response, radius + 1, constant_values=-np.inf)
    last = np.array(response.shape[::-1]) - 1
    at = np.clip(np.rint(places), 0, last).astype(np.int64) + radius + 1
    window = padded[at[:, 1, None, None] + steps[:, None], at[:, 0, None, None] + steps]
    best = window.reshape(len(places), len(steps) ** 2).argmax(axis=1)
    y, x = best // len(steps) - radius, best % len(steps) - radius
    row, column = at[:, 1] + y, at[:, 0] + x
    strength = padded[row, column]
    across = (padded[row, column - 1], padded[row, column + 1])
    along = (padded[row - 1, column], padded[row + 1, column])
    peak = np.maximum(*across) <= strength
    peak &= (np.maximum(*along) <= strength) & np.isfinite(np.minimum(*across) + np.minimum(*along))
    vertex = np.column_stack([_vertex(*across, strength, peak), _vertex(*along, strength, peak)])
    return np.column_stack([column, row]) - radius - 1 + vertex, np.where(peak, strength, 0.0)


def _vertex(before: Floats, after: Floats, centre: Floats, defined: NDArray[np.bool_]) -> Floats:
    """Where parabolas through three neighbours, of which the middle is the largest, have their vertex."""
    before, after, centre = (np.where(defined, values, 0.0) for values in (before, after, centre))
    curvature = 2.0 * centre - before - after
    return np.asarray(0.5 * (after - before) / np.where(curvature > 0, curvature, 1.0))
