"""Views of a planar array from plain or calibrated pictures, with the range of their disparities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvc.array_files import read_pictures
from dvc.arrays import Bytes, Floats
from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.camera_estimation import Features
from dvc.geometry.camera_files import AUTO, load_cameras
from dvc.stereo.rectification.disparity_range import (
    MIN_MATCHES,
    RowMatches,
    range_of,
    range_of_matches,
    row_matches,
    suggested_labels,
)
from dvc.stereo.rectification.rectified_space import MAX_RESAMPLED_SIDE, Rectification, resample
from dvc.stereo.rectification.rectify import rectify, refined_pair, usual_disparity

MAX_OFF_PLANE_PX = 10.0
"""Largest error of (2.5) at the corners of pictures of cameras that are slightly off a plane."""


@dataclass(frozen=True, eq=False)
class RectifiedArray:
    """Rectified views of a planar array.

    Attributes
    ----------
    array : CameraArray
        The rectified views.
    rectification : Rectification
        Their transformation.
    disparities : (float, float) or None
        Lowest and highest disparity of known points of the scene; None if unknown.
    off_plane_px : ndarray of shape (N,), float64
        Largest error of (2.5) in each view because its camera is off the plane of all.
    matches : RowMatches or None
        Matches between the views, if needed or asked for.
    refined : bool
        Whether the calibration of a pair was refined by them.
    """

    array: CameraArray
    rectification: Rectification
    disparities: tuple[float, float] | None
    off_plane_px: Floats
    matches: RowMatches | None
    refined: bool = False

    @property
    def labels(self) -> DisparityLabels | None:
        """Disparities to try: the known range and a margin, in steps of a pixel, or less if narrow."""
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
        Positions of the cameras, one for each; by default from their centres.
    with_matches : bool, optional
        Match the views even if points of the scene are known.
    keep_cameras : bool, optional
        Use the calibration of a pair unchanged, even if the rows of matches contradict it.
    advance : callable, optional
        Called with the number of finished views.

    Returns
    -------
    RectifiedArray
        The views in this order, named as their files.

    Raises
    ------
    DvcError
        If a file cannot be read, cameras are missing, or they are not in a plane.
    """
    if positions is not None and len(positions) != len(paths):
        raise ConfigError(f"{len(paths)} views and {len(positions)} positions: one for each is needed")
    pictures = read_pictures(paths)
    is_pair = len(pictures) == 2
    features = [Features(picture) for picture in pictures] if with_matches or is_pair else []
    views = load_cameras(cameras, paths, pictures, features)
    if not features and not len(views.points):
        features = [Features(picture) for picture in pictures]
    calibrated = views.cameras
    if is_pair and not keep_cameras and str(cameras) != AUTO:
        calibrated = refined_pair(views.cameras, *features[0].match(features[1]))
    rectification = rectify(calibrated, positions, views.points)
    array = _resampled(rectification, paths, pictures, advance)
    disparities, matches = _range_of_points(rectification, views.points), None
    if features:
        matches = row_matches(rectification.positions, features, rectification.rectified_points)
        disparities = disparities or range_of_matches(matches)
    off_plane_px = _checked_plane(rectification, disparities)
    refined = calibrated != views.cameras
    return RectifiedArray(array, rectification, disparities, off_plane_px, matches, refined)


def _resampled(
    rectification: Rectification,
    paths: Sequence[str | Path],
    pictures: Sequence[Bytes],
    advance: Callable[[int], None],
) -> CameraArray:
    """Return the rectified views of pictures, named as their files."""
    if max(rectification.size) > MAX_RESAMPLED_SIDE:
        size = "x".join(map(str, rectification.size))
        raise ConfigError(
            f"rectified views would have {size} pixels, sides of at most {MAX_RESAMPLED_SIDE} are accepted"
        )
    views = []
    for index, (path, picture) in enumerate(zip(paths, pictures, strict=True)):
        image, valid = resample(rectification, index, picture)
        mask = None if valid.all() else valid
        views.append(ArrayView(Path(path).stem, image, rectification.positions[index], mask))
        advance(1)
    return CameraArray(tuple(views))


def _range_of_points(rectification: Rectification, points: Floats) -> tuple[float, float] | None:
    disparities = rectification.disparities(points)
    disparities = disparities[np.isfinite(disparities) & (disparities > -rectification.disparity_shift)]
    if not disparities.size:
        return None
    if disparities.size < MIN_MATCHES:
        return float(disparities.min()), float(disparities.max())
    return range_of(disparities)


def _checked_plane(rectification: Rectification, disparities: tuple[float, float] | None) -> Floats:
    """Return the distance of each camera from the plane in pixels of parallax; refuse large ones."""
    if disparities is None:
        width = max(camera.size[0] for camera in rectification.cameras)
        shift = rectification.disparity_shift
        disparities = -shift, usual_disparity(rectification.positions, width) - shift
    off_plane_px = rectification.off_plane_px(*disparities)
    worst = int(off_plane_px.argmax())
    if off_plane_px[worst] > MAX_OFF_PLANE_PX:
        raise DvcError(
            f"the cameras are not in a plane: {rectification.cameras[worst].name} is off by up to "
            f"{off_plane_px[worst]:.1f} px of parallax, at most {MAX_OFF_PLANE_PX:g} px are accepted"
        )
    return off_plane_px
