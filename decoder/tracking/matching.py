"""Tracks of a group of pictures from received points.

A detector finds the strongest response near the point of a correspondence, about a pixel away, in every
frame. Matching therefore follows the curve of the corner, between the strongest responses in the key frames.
The final track is that of the point itself, at its offset from the corner. [Maitre2008] Sec. 5.4.2.
"""

import math
from typing import NamedTuple

import numpy as np

from decoder.tracking.curves import SNAKE_RADII_PX, ReceivedPoints, fit_snakes, register
from dvc.arrays import Bytes, Floats, Mask
from dvc.corners import SENT_WINDOW_PX, corner_response, spaced
from dvc.tracks import FeaturePoints, PointTracks
from sfm.scene_model import Correspondences, Reconstruction

SEARCH_RADIUS_PX = 2
"""Largest distance of a corner from its point, by rows and by columns."""
MAX_DRIFT_PX = 1.5
"""Largest change of the position of a corner relative to its point in the scene."""
NUM_SNAKES = 400  # most correspondences that are followed
SEPARATION_PX = 3.0  # least distance between their corners in the first key frame
SUPPORT = 0.3  # least share of the tracked frames with a point that a snake has located
# a frame is followed if more snakes than this many standard deviations above chance found a point
SIGNIFICANCE = 6.0
MIN_MATCHES = 10  # ... and as many more as an affine map and its search may fit by chance


def match_points(
    reconstruction: Reconstruction, first: Bytes, second: Bytes, points: FeaturePoints
) -> PointTracks:
    """Find the tracks between two key frames that corners of the frames between belong to."""
    from sfm.correspondences import outliers

    size, frames = np.array(first.shape[::-1]), []
    for frame in points.frames:  # without points outside the image, and without duplicates
        received = np.asarray(frame, dtype=np.float64).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            inside = np.logical_and(received >= -0.5, received <= size - 0.5).all(axis=1)
        frames.append(ReceivedPoints(np.unique(received[inside], axis=0)))
    num_instants = len(frames) + 2
    # Correspondences of a reliable model are trusted, or else those matched that move alike.
    if reconstruction.model is not None and reconstruction.success:
        trusted = reconstruction.model.correspondences
    else:
        trusted = reconstruction.stages.get("matching", Correspondences.empty())
        if len(trusted):
            trusted = trusted[outliers.motion(trusted)]
    pairs = choose_paired_corners(trusted, first, second, NUM_SNAKES, SEPARATION_PX)
    if not frames or not len(pairs):
        return PointTracks.none(num_instants)
    temporal_positions = np.arange(1, num_instants - 1) / (num_instants - 1)
    deviation = register(pairs.first, pairs.second, temporal_positions, frames)
    expected = pairs.corners(temporal_positions) + np.swapaxes(deviation, 0, 1)
    snakes = fit_snakes(pairs.first, pairs.second, expected, frames)
    seen = np.isfinite(snakes.received[..., 0])
    # Frames count if snakes located more points in them than among random ones.
    density = np.array([len(frame) for frame in frames]) / first.size
    by_chance = len(seen) * math.pi * SNAKE_RADII_PX[-1] ** 2 * density
    least = by_chance + SIGNIFICANCE * np.sqrt(by_chance) + MIN_MATCHES
    seen &= np.count_nonzero(seen, axis=0) >= least
    positions = np.where(seen[..., None], snakes.positions - pairs.offsets(temporal_positions), np.nan)
    needed = max(1.0, SUPPORT * np.count_nonzero(seen.any(axis=0)))
    supported = np.count_nonzero(seen, axis=1) >= needed
    ends = pairs.pairs.first[:, None], pairs.pairs.second[:, None]
    return PointTracks(np.concatenate([ends[0], positions, ends[1]], axis=1)[supported])


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
        t = temporal_positions[None, :, None]
        return (1.0 - t) * self.first[:, None] + t * self.second[:, None]

    def offsets(self, temporal_positions: Floats) -> Floats:
        """Return how far the corners are from their points."""
        differences = self.first - self.pairs.first, self.second - self.pairs.second
        return PairedCorners(self.pairs, *differences).corners(temporal_positions)


def choose_paired_corners(
    pairs: Correspondences, first: Bytes, second: Bytes, num_corners: int, separation_px: float
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


def _vertex(before: Floats, after: Floats, centre: Floats, defined: Mask) -> Floats:
    """Return the vertices of parabolas through three neighbours; the middle one is the largest."""
    before, after, centre = (np.where(defined, values, 0.0) for values in (before, after, centre))
    curvature = 2.0 * centre - before - after
    return np.asarray(0.5 * (after - before) / np.where(curvature > 0, curvature, 1.0))
