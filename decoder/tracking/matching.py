"""From received corners to tracks: the choice of correspondences, and their positions in each frame.

References
----------
[Maitre2008] Sec. 5.4.2.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.paired_corners import choose_paired_corners
from decoder.tracking.registration import ReceivedPoints, RegistrationSettings, register
from decoder.tracking.snakes import SnakeSettings, fit_snakes
from dvc.tracks.points import FeaturePoints, PointTracks
from sfm.scene_model import Correspondences, Reconstruction

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackingSettings:
    """How received points become tracks."""

    num_snakes: int = 400  # most correspondences that are followed
    separation_px: float = 3.0  # least distance between their corners in the first key frame
    # difference from the neighbours' motion that is always allowed, and in units of their own spread
    motion_limit_px: float = 2.0
    motion_spreads: float = 3.0
    # how the common deviation of a frame is found
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    snakes: SnakeSettings = field(default_factory=SnakeSettings)  # how snakes are fitted
    support: float = 0.3  # least share of the tracked frames in which a snake has located a point
    # a frame is followed if more snakes than this many standard deviations above chance found a point
    significance: float = 6.0
    # ... and as many more as an affine map and its search may fit by chance
    min_matches: int = 10


def match_points(
    reconstruction: Reconstruction,
    first: Luma,
    second: Luma,
    points: FeaturePoints,
    settings: TrackingSettings | None = None,
) -> PointTracks:
    """Find the tracks between two key frames that corners of the frames between belong to."""
    settings = settings or TrackingSettings()
    frames = [ReceivedPoints(_inside(frame, first.shape)) for frame in points.frames]
    num_instants = len(frames) + 2
    known = _known(reconstruction, settings)
    pairs = choose_paired_corners(known, first, second, settings.num_snakes, settings.separation_px)
    if not frames or not len(pairs):
        return PointTracks.none(num_instants)
    temporal_positions = np.arange(1, num_instants - 1) / (num_instants - 1)
    deviation = register(pairs.first, pairs.second, temporal_positions, frames, settings.registration)
    expected = pairs.corners(temporal_positions) + np.swapaxes(deviation, 0, 1)
    snakes = fit_snakes(pairs.first, pairs.second, expected, frames, settings.snakes)
    seen = np.isfinite(snakes.received[..., 0])
    seen &= _beyond_chance(seen, frames, first.size, settings)
    positions = np.where(seen[..., None], snakes.positions - pairs.offsets(temporal_positions), np.nan)
    needed = max(1.0, settings.support * np.count_nonzero(seen.any(axis=0)))
    supported = np.count_nonzero(seen, axis=1) >= needed
    ends = pairs.pairs.first[:, None], pairs.pairs.second[:, None]
    return PointTracks(np.concatenate([ends[0], positions, ends[1]], axis=1)[supported])


def _beyond_chance(
    seen: Mask, frames: list[ReceivedPoints], num_pixels: int, settings: TrackingSettings
) -> Mask:
    """Return a mask (T,) of frames in which snakes located more points than among random ones."""
    disc_px2 = math.pi * settings.snakes.radii_px[-1] ** 2
    density = np.array([len(frame) for frame in frames]) / num_pixels
    expected = len(seen) * disc_px2 * density
    min_found = expected + settings.significance * np.sqrt(expected) + settings.min_matches
    return np.asarray(np.count_nonzero(seen, axis=0) >= min_found)


def _inside(points: Floats, shape: tuple[int, ...]) -> Floats:
    """Remove points outside the image, and duplicates."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    size = np.array(shape[::-1])
    with np.errstate(invalid="ignore"):
        inside = np.logical_and(points >= -0.5, points <= size - 0.5).all(axis=1)
    return np.unique(points[inside], axis=0)


def _known(reconstruction: Reconstruction, settings: TrackingSettings) -> Correspondences:
    """Return the correspondences of a model that can be trusted, or those matched that move alike."""
    from sfm.correspondences import outliers

    if reconstruction.model is not None and reconstruction.success:
        return reconstruction.model.correspondences
    pairs = reconstruction.stages.get("matching", Correspondences.empty())
    if not len(pairs):
        return pairs
    return pairs[outliers.motion(pairs, settings.motion_limit_px, settings.motion_spreads)]
