"""Cameras of the frames between two key frames: each by itself, or all by the regularity of their path."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import project
from sfm.cameras.camera_prior import ExpectedPoints
from sfm.cameras.projective_basis import normalized_camera
from sfm.cameras.resection import Resection, ResectionSettings, resection
from sfm.cameras.tracked_points import TrackedPoints
from sfm.model import Model

Floats = NDArray[np.float64]

NUM_SWEEPS = 12
"""Bound on how often every camera is found again with its neighbours held."""
CONVERGED_PX = 0.01
"""Sweeps end when no camera moves the points of the scene by more than this, root mean square."""
JERK_PX = 1.0
"""Second differences above this count linearly, not squared: a jerk is a jerk."""
_NEAREST = 1e-3
"""Least depth, relative to the median of a camera's points, at which a point tells about the path."""


def interpolated_camera(model: Model, temporal_position: float) -> Floats:
    """Guess the camera of a temporal position: between those of the key frames.

    Parameters
    ----------
    model : Model
        Whose cameras are mixed.
    temporal_position : float
        0 at the first and 1 at the second key frame.

    Returns
    -------
    ndarray of shape (3, 4), float64
        Projection matrix in normalised coordinates, Frobenius norm sqrt(3).
    """
    first, second = (1.0 - temporal_position) * model.first_camera, temporal_position * model.second_camera
    return normalized_camera(first + second)


def intermediate_cameras(
    model: Model, instants: Sequence[TrackedPoints], settings: ResectionSettings | None = None
) -> list[Resection]:
    """Find the cameras of any instants, from real tracks or from guessed ones alike.

    The points stay; so the cameras do not depend on each other.

    Parameters
    ----------
    model : Model
        The scene.
    instants : sequence of TrackedPoints
        From `tracked_points`, or from `linear_points` where there are no tracks.
    settings : ResectionSettings, optional
        Parameters; the defaults if None.

    Returns
    -------
    list of Resection
        One for each instant.

    References
    ----------
    [Maitre2008] Eq. (5.7) with the depths fixed.
    """
    return [
        resection(
            instant.points,
            instant.positions,
            model.pixel_frame,
            prior=interpolated_camera(model, instant.temporal_position),
            settings=settings,
        )
        for instant in instants
    ]


def regular_cameras(
    model: Model,
    instants: Sequence[TrackedPoints],
    regularity: float,
    settings: ResectionSettings | None = None,
) -> list[Resection]:
    """Find the cameras of evenly spaced instants, and let their path be smooth.

    With a regularity W the cameras minimise

        sum_t  mean_n rho(|P_t X_n - x_tn|)  +  W sum_t  h(rms_m |P_(t-1) X_m - 2 P_t X_m + P_(t+1) X_m|)

    and what `resection` adds for each camera to tie it, weakly, to that of an even motion. P X is the image
    point in pixels, x_tn the track of point n, X_m the points that were tracked from key frame to key frame,
    rho the robust squared distance of `resection`, and h(d) = d^2 up to `JERK_PX`, linear above. Second
    differences are those of image points, not of matrices, so that neither the projective basis nor the
    scale of the matrices matters. The key frames' cameras stay.

    One camera after the other is found again with its neighbours held: the three second differences that it
    takes part in are least squares of its distances from points that the neighbours let be expected, so
    each step is a resection.

    Parameters
    ----------
    model : Model
        The scene.
    instants : sequence of TrackedPoints
        All instants between the key frames, evenly spaced, in order.
    regularity : float
        W; with 0 the cameras do not depend on each other.
    settings : ResectionSettings, optional
        Parameters; the defaults if None.

    Returns
    -------
    list of Resection
        One for each instant. Cameras that could not be found by themselves have no part in the path.

    Raises
    ------
    ValueError
        If `regularity` is negative.

    References
    ----------
    [Maitre2008] Eq. (5.7) with the depths fixed, with a penalty of its own.
    """
    if not regularity >= 0:
        raise ValueError(f"`regularity` must not be negative, got {regularity}")
    found = intermediate_cameras(model, instants, settings)
    if regularity == 0 or not instants:
        return found
    path = _Path(model, instants[0].points, found)
    if path.num_points == 0:
        return found
    for _ in range(NUM_SWEEPS):
        moved_px = 0.0
        for t, instant in enumerate(instants, 1):
            expected = path.expected(t, regularity)
            if expected is None:
                continue
            prior = interpolated_camera(model, instant.temporal_position)
            again = resection(
                instant.points,
                instant.positions,
                model.pixel_frame,
                prior=prior,
                settings=settings,
                expected=expected,
            )
            if again.success:
                found[t - 1] = again
                moved_px = max(moved_px, path.update(t, again.camera))
        if moved_px < CONVERGED_PX:
            break
    return found


class _Path:
    """Where the cameras of all frames, key frames included, see the points of the scene."""

    def __init__(self, model: Model, points: Floats, found: Sequence[Resection]) -> None:
        self._frame = model.pixel_frame
        cameras = [camera.camera if camera.success else None for camera in found]
        every = [model.first_camera, *cameras, model.second_camera]
        known = np.isfinite(points).all(axis=1)
        for camera in every:
            if camera is not None:
                depth = np.where(known, points @ camera[2], 0.0)
                usual = np.median(depth[known]) if known.any() else 0.0
                known &= depth > _NEAREST * usual
        self._points = points[known]
        self._seen = [None if camera is None else self._project(camera) for camera in every]

    @property
    def num_points(self) -> int:
        """Points in front of all cameras."""
        return len(self._points)

    def _project(self, camera: Floats) -> Floats:
        positions: Floats = self._frame.to_pixels(project(camera, self._points)[0])
        return positions

    def update(self, t: int, camera: Floats) -> float:
        """Replace a camera; return how far it moves the points, root mean square in pixels."""
        before, after = self._seen[t], self._project(camera)
        self._seen[t] = after
        return 0.0 if before is None else _rms(after - before)

    def expected(self, t: int, regularity: float) -> ExpectedPoints | None:
        """Say where the neighbours of a frame let the points be expected; None without neighbours."""
        here = self._seen[t]
        if here is None:
            return None
        total, positions = 0.0, np.zeros((self.num_points, 2))
        for centre, own in ((t - 1, 1.0), (t, -2.0), (t + 1, 1.0)):
            if not 0 < centre < len(self._seen) - 1:
                continue
            three = self._seen[centre - 1], self._seen[centre], self._seen[centre + 1]
            if three[0] is None or three[1] is None or three[2] is None:
                continue
            difference = three[0] - 2.0 * three[1] + three[2]
            weight = own * own / max(1.0, _rms(difference) / JERK_PX)
            positions += weight * (here - difference / own)
            total += weight
        if total == 0.0:
            return None
        return ExpectedPoints(self._points, positions / total, regularity * total)


def _rms(offsets: Floats) -> float:
    return float(np.sqrt((offsets * offsets).sum(axis=1).mean()))
