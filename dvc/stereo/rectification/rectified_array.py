"""From plain or calibrated pictures to the views of a planar array, and the disparities that they have."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import read_pictures
from dvc.errors import ConfigError, DvcError
from dvc.geometry.calibrated_cameras import CalibratedViews
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.camera_files import AUTO, load_cameras
from dvc.geometry.feature_matching import Features
from dvc.stereo.rectification.disparity_range import (
    MIN_MATCHES,
    RowMatches,
    range_of,
    range_of_matches,
    row_matches,
    suggested_labels,
)
from dvc.stereo.rectification.rectified_space import Rectification
from dvc.stereo.rectification.rectify import rectify, usual_disparity
from dvc.stereo.rectification.refinement import refined_pair
from dvc.stereo.rectification.resampling import MAX_SIDE, resample

Floats = NDArray[np.float64]

MAX_OFF_PLANE_PX = 10.0
"""How far (2.5) may fail at the corners of pictures whose cameras are not quite in a plane."""


@dataclass(frozen=True, eq=False)
class RectifiedArray:
    """Views of a planar array made of other pictures.

    Attributes
    ----------
    array : CameraArray
        The rectified views.
    rectification : Rectification
        How they were made.
    disparities : (float, float) or None
        Lowest and highest that were found in the scene; None where nothing is known.
    off_plane_px : ndarray of shape (N,), float64
        How far at most (2.5) fails in each view because its camera is not in the plane of all.
    matches : RowMatches or None
        Matches between the views, if they were looked for.
    refined : bool
        Whether the calibration of a pair was changed to agree with them.
    """

    array: CameraArray
    rectification: Rectification
    disparities: tuple[float, float] | None
    off_plane_px: Floats
    matches: RowMatches | None
    refined: bool = False

    @property
    def labels(self) -> DisparityLabels | None:
        """Disparities to try: those found and a margin, in steps of a pixel, or less where they are few."""
        return None if self.disparities is None else suggested_labels(*self.disparities)


def rectified_array(
    paths: Sequence[str | Path],
    cameras: str | Path,
    positions: Sequence[LatticePosition] | None = None,
    *,
    with_matches: bool = False,
    keep_cameras: bool = False,
    advance: Callable[[int], None] = lambda _: None,
) -> RectifiedArray:
    """Read pictures and rectify them.

    Parameters
    ----------
    paths : sequence of str or Path
        At least two pictures.
    cameras : str or Path
        As for `dvc.geometry.camera_files.load_cameras`.
    positions : sequence of LatticePosition, optional
        Places of the cameras, one for each; found from their centres if None.
    with_matches : bool, optional
        Look for matches between the views even where points of the scene are known.
    keep_cameras : bool, optional
        Take the calibration of a pair as it is, even where the rows of matches contradict it.
    advance : callable, optional
        Told the number of views that have just been finished.

    Returns
    -------
    RectifiedArray
        The views in this order; they are named as their files.

    Raises
    ------
    DvcError
        If a file cannot be read, cameras are missing, or they do not stand in a plane.
    """
    if positions is not None and len(positions) != len(paths):
        raise ConfigError(f"{len(paths)} views and {len(positions)} positions: one for each is needed")
    pictures = read_pictures(paths)
    features = [Features(picture) for picture in pictures] if with_matches or len(pictures) == 2 else []
    views = load_cameras(cameras, paths, pictures, features)
    if not len(views.points):
        features = features or [Features(picture) for picture in pictures]
    given = views.cameras
    if len(pictures) == 2 and not keep_cameras and str(cameras) != AUTO:
        refined = refined_pair(given, *features[0].match(features[1]))
        views = CalibratedViews(refined, views.points)
    rectification = rectify(views.cameras, positions, views.points)
    if max(rectification.size) > MAX_SIDE:
        size = "x".join(map(str, rectification.size))
        raise ConfigError(
            f"rectified views would have {size} pixels, sides of at most {MAX_SIDE} are accepted"
        )
    stems = [Path(path).stem for path in paths]
    made = []
    for index, (name, picture) in enumerate(zip(stems, pictures, strict=True)):
        image, valid = resample(rectification, index, picture)
        everywhere = bool(valid.all())
        made.append(ArrayView(name, image, rectification.positions[index], None if everywhere else valid))
        advance(1)
    found, matches = _range_of_points(rectification, views.points), None
    if features:
        matches = row_matches(rectification.positions, features, rectification.rectified_points)
        found = found or range_of_matches(matches)
    off_plane_px = _checked_plane(rectification, found)
    array, refined_cameras = CameraArray(tuple(made)), views.cameras != given
    return RectifiedArray(array, rectification, found, off_plane_px, matches, refined_cameras)


def _range_of_points(rectification: Rectification, points: Floats) -> tuple[float, float] | None:
    disparities = rectification.disparities(points)
    disparities = disparities[np.isfinite(disparities) & (disparities > -rectification.disparity_shift)]
    if not disparities.size:
        return None
    if disparities.size < MIN_MATCHES:
        return float(disparities.min()), float(disparities.max())
    return range_of(disparities)


def _checked_plane(rectification: Rectification, found: tuple[float, float] | None) -> Floats:
    """Return how far each camera is off the plane, in pixels of parallax; refuse what is too far."""
    if found is None:
        width = max(camera.size[0] for camera in rectification.cameras)
        shift = rectification.disparity_shift
        found = -shift, usual_disparity(rectification.positions, width) - shift
    off_plane_px = rectification.off_plane_px(*found)
    worst = int(off_plane_px.argmax())
    if off_plane_px[worst] > MAX_OFF_PLANE_PX:
        raise DvcError(
            f"the cameras do not stand in a plane: {rectification.cameras[worst].name} is off by up to "
            f"{off_plane_px[worst]:.1f} px of parallax, at most {MAX_OFF_PLANE_PX:g} px are accepted"
        )
    return off_plane_px
