"""Corners of the key frames that detectors are likely to find in the frames between as well.

In every frame a detector finds the strongest response near the point of a correspondence, about a pixel away.
Matching therefore follows the curve of the corner, between the strongest responses in the key frames. The
final track is that of the point itself, at its offset from the corner.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.corners import SENT_WINDOW_PX, corner_response, spaced
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

SEARCH_RADIUS_PX = 2
"""How far a corner may be from its point, by rows and by columns."""

MAX_DRIFT_PX = 1.5
"""Largest change of the position of a corner relative to its point: others are no corners of the scene."""


class PairedCorners(NamedTuple):
    """Correspondences, and the corners next to them."""

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
    """Return the vertices of parabolas through three neighbours; the middle one is the largest."""
    before, after, centre = (np.where(defined, values, 0.0) for values in (before, after, centre))
    curvature = 2.0 * centre - before - after
    return np.asarray(0.5 * (after - before) / np.where(curvature > 0, curvature, 1.0))
