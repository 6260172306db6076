"""From received corners to tracks: which correspondences to follow, and where they are in each frame.

References
----------
[Maitre2008] Sec. 5.4.2.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.registration import RegistrationSettings, register
from decoder.tracking.snakes import SnakeSettings, fit_snakes
from dvc.tracks.points import FeaturePoints, PointTracks
from sfm.model import Correspondences, Reconstruction

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackingSettings:
    """How received points become tracks.

    Attributes
    ----------
    num_snakes : int
        Most correspondences that are followed.
    separation_px : int
        Least distance between them in the first key frame.
    corner_radius_px : int
        A corner's response is the strongest up to this distance, by rows and by columns.
    motion_limit_px, motion_spreads : float
        Difference from the neighbours' motion that is always allowed, and in units of their own spread.
    registration : RegistrationSettings
        How the common deviation of a frame is found.
    snakes : SnakeSettings
        How snakes are fitted.
    support : float
        Share of the frames in which a snake must have found a point.
    """

    num_snakes: int = 400
    separation_px: int = 5
    corner_radius_px: int = 3
    motion_limit_px: float = 2.0
    motion_spreads: float = 3.0
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    snakes: SnakeSettings = field(default_factory=SnakeSettings)
    support: float = 0.3


def match_points(
    reconstruction: Reconstruction,
    first: Luma,
    second: Luma,
    points: FeaturePoints,
    settings: TrackingSettings | None = None,
) -> PointTracks:
    """Find the tracks between two key frames that corners of the frames between belong to.

    Parameters
    ----------
    reconstruction : Reconstruction
        What is known of the key frames: the correspondences of its model, or where there is none, those
        that were matched.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    points : FeaturePoints
        Corners of each frame between them.
    settings : TrackingSettings, optional
        Parameters; the defaults if None.

    Returns
    -------
    PointTracks
        A track for each correspondence that enough corners belong to; nan where it found none.
    """
    settings = settings or TrackingSettings()
    frames = [_inside(np.asarray(frame, dtype=np.float64), first.shape) for frame in points.frames]
    num_instants = len(frames) + 2
    pairs = choose_correspondences(reconstruction, first, second, settings)
    if not frames or not len(pairs):
        return PointTracks.none(num_instants)
    deviation = register(pairs.first, pairs.second, frames, settings.registration)
    late = (np.arange(1, num_instants - 1) / (num_instants - 1))[:, None]
    even = (1.0 - late) * pairs.first[:, None] + late * pairs.second[:, None]
    expected = even + np.stack(deviation, axis=1)
    snakes = fit_snakes(pairs.first, pairs.second, expected, frames, settings.snakes)
    seen = np.isfinite(snakes.received[..., 0])
    positions = np.where(seen[..., None], snakes.positions, np.nan)
    supported = seen.sum(axis=1) >= max(1.0, settings.support * len(frames))
    tracks = np.concatenate([pairs.first[:, None], positions, pairs.second[:, None]], axis=1)
    return PointTracks(tracks[supported])


def _inside(points: Floats, shape: tuple[int, ...]) -> Floats:
    """Leave out what is no point of the image, and what is there twice."""
    points = points.reshape(-1, 2)
    size = np.array(shape[::-1])
    with np.errstate(invalid="ignore"):
        inside = np.logical_and(points >= -0.5, points <= size - 0.5).all(axis=1)
    return np.unique(points[inside], axis=0)


def choose_correspondences(
    reconstruction: Reconstruction, first: Luma, second: Luma, settings: TrackingSettings
) -> Correspondences:
    """Choose correspondences that are corners in both key frames, the strongest first, spread out.

    Parameters
    ----------
    reconstruction : Reconstruction
        What is known of the key frames.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    settings : TrackingSettings
        How many, and what makes a corner.

    Returns
    -------
    Correspondences
        At most `num_snakes`.
    """
    from sfm.features import harris_response

    pairs = _known(reconstruction, settings)
    if not len(pairs):
        return pairs
    strength, corner = np.full(len(pairs), np.inf), np.ones(len(pairs), dtype=bool)
    for luma, places in ((first, pairs.first), (second, pairs.second)):
        peak, is_corner = _corner_strength(harris_response(luma), places, settings.corner_radius_px)
        strength, corner = np.minimum(strength, peak), corner & is_corner
    candidates = np.flatnonzero(corner)
    order = candidates[np.argsort(-strength[candidates], kind="stable")]
    return pairs[_spread(pairs.first, order, settings)]


def _known(reconstruction: Reconstruction, settings: TrackingSettings) -> Correspondences:
    """Return the best correspondences that there are."""
    from sfm import outliers

    if reconstruction.model is not None:
        return reconstruction.model.correspondences
    pairs = reconstruction.stages.get("matching", Correspondences.empty())
    if not len(pairs):
        return pairs
    return pairs[outliers.motion(pairs, settings.motion_limit_px, settings.motion_spreads)]


def _corner_strength(response: Floats, places: Floats, radius: int) -> tuple[Floats, Mask]:
    """Return the strongest response at a point or beside it, and whether that is a corner."""
    import cv2

    height, width = response.shape
    at = np.rint(places).astype(np.int64)
    x, y = np.clip(at[:, 0], 0, width - 1), np.clip(at[:, 1], 0, height - 1)
    beside = cv2.dilate(response, np.ones((3, 3), np.uint8))[y, x]
    around = cv2.dilate(response, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))[y, x]
    return np.asarray(beside, dtype=np.float64), np.asarray((beside >= around) & (beside > 0))


def _spread(places: Floats, order: NDArray[np.int64], settings: TrackingSettings) -> NDArray[np.int64]:
    """Take points in order, except those near one that was taken."""
    chosen: list[int] = []
    taken = np.empty((settings.num_snakes, 2))
    for index in order:
        if len(chosen) == settings.num_snakes:
            break
        distance = np.abs(taken[: len(chosen)] - places[index]).max(axis=1)
        if not (distance < settings.separation_px).any():
            taken[len(chosen)] = places[index]
            chosen.append(int(index))
    return np.array(chosen, dtype=np.int64)
