"""Views of a planar array from plain or calibrated pictures, with the range of their disparities."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvc.array_files import MAX_LABELS, read_pictures
from dvc.arrays import Bytes, Floats
from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.camera_estimation import Features
from dvc.geometry.camera_files import AUTO, load_cameras
from dvc.stereo.rectification.rectified_space import MAX_RESAMPLED_SIDE, Rectification, resample
from dvc.stereo.rectification.rectify import rectify, refined_pair, usual_disparity
from dvc.stereo.surfaces.occupancy import neighbours

MAX_OFF_PLANE_PX = 10.0
"""Largest error of (2.5) at the corners of pictures of cameras that are slightly off a plane."""
ROW_TOLERANCE_PX = 2.0
"""Largest distance of correct matches from positions that (2.5) allows."""
QUANTILES, INNER_QUANTILES = (0.01, 0.99), (0.05, 0.95)
"""Quantiles of the range, and inner ones that limit it: their distance bounds that to the former."""
FAR_MARGIN, NEAR_MARGIN, MARGIN_PX = 0.15, 0.35, 1.0
"""Margins of the range of known disparities, as shares of it and in pixels; near points are rare."""
MIN_MATCHES = 20
MIN_LABELS = 16
MAX_OUTSIDE = 0.9
"""Share of matches outside a range of disparities that proves it wrong."""
_MAX_PARTNERS = 8


@dataclass(frozen=True, eq=False)
class RowMatches:
    """Matches of the reference view with other views."""

    disparities: Floats  # disparities of matches that agree with (2.5), in pixels per unit of m
    residuals_px: Floats  # distances from (2.5) across the direction of parallax

    @property
    def rms_px(self) -> float | None:
        """Root of the mean squared residual; None without matches."""
        return float(np.sqrt((self.residuals_px**2).mean())) if self.residuals_px.size else None


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


def range_of_matches(matches: RowMatches) -> tuple[float, float] | None:
    """Return the range of the disparities of matches."""
    return range_of(matches.disparities) if len(matches.disparities) >= MIN_MATCHES else None


def labels_of_matches(array: CameraArray) -> DisparityLabels | None:
    """Return the disparities to try for rectified views, from their matches."""
    positions, features = [view.position for view in array], [Features(view.image) for view in array]
    limits = range_of_matches(row_matches(positions, features))
    return None if limits is None else suggested_labels(*limits)


def check_disparities(array: CameraArray, labels: DisparityLabels, jobs: int = 1) -> None:
    """Compare disparities to try with matches of the reference view and its neighbours."""
    reference = array.reference
    near = neighbours(array, reference).all
    with ThreadPoolExecutor(jobs) as pool:
        features, *neighbour_features = pool.map(
            Features, [array[index].image for index in (reference, *near)]
        )
    for index, other in zip(near, neighbour_features, strict=True):
        pair = array[reference], array[index]
        origin, target = (view.position for view in pair)
        baseline = LatticePosition(target.m - origin.m, target.n - origin.n)
        disparities = row_matches([LatticePosition(0.0, 0.0), baseline], [features, other]).disparities
        slack = MARGIN_PX / float(np.hypot(*baseline))
        outside = (disparities < labels.lowest - slack) | (disparities > labels.highest + slack)
        if len(disparities) < MIN_MATCHES or outside.mean() < MAX_OUTSIDE:
            continue
        low, high = range_of(disparities)
        raise ConfigError(
            f"matches of {pair[0].name} and {pair[1].name} have disparities from {low:.3g} to "
            f"{high:.3g} px, not {labels.lowest:g} to {labels.highest:g}: the range, the order "
            "or the positions of the views are wrong"
        )


def range_of(disparities: Floats) -> tuple[float, float]:
    """Return the range of known disparities without outliers."""
    lowest, low, high, highest = np.quantile(disparities, sorted(QUANTILES + INNER_QUANTILES))
    return float(max(lowest, 2.0 * low - high)), float(min(highest, 2.0 * high - low))


def suggested_labels(lowest: float, highest: float) -> DisparityLabels:
    """Return disparities to try around a range of known ones."""
    low = lowest - FAR_MARGIN * (highest - lowest) - MARGIN_PX
    high = highest + NEAR_MARGIN * (highest - lowest) + MARGIN_PX
    step = min(1.0, 2.0 ** math.floor(math.log2((high - low) / MIN_LABELS)))
    step = max(step, 2.0 ** math.ceil(math.log2((high - low) / (MAX_LABELS - 2))))
    first, last = math.floor(low / step), math.ceil(high / step)
    return DisparityLabels(first * step, step, last - first + 1)


def row_matches(
    positions: Sequence[LatticePosition],
    features: Sequence[Features],
    rectified: Callable[[int, Floats], Floats] = lambda _, points: points,
) -> RowMatches:
    """Match the reference view with the views nearest to it."""
    centres = np.array(positions)
    distance = np.linalg.norm(centres, axis=1)
    reference = int(distance.argmin())
    nearest = np.argsort(np.linalg.norm(centres - centres[reference], axis=1), kind="stable")
    disparities, residuals = [np.zeros(0)], [np.zeros(0)]
    for index in nearest[1 : 1 + _MAX_PARTNERS]:
        here, there = features[reference].match(features[index])
        moved = rectified(reference, here) - rectified(int(index), there)
        baseline = centres[index] - centres[reference]
        unit = baseline / np.linalg.norm(baseline)
        across = moved @ np.array([-unit[1], unit[0]])
        close = np.abs(across) <= ROW_TOLERANCE_PX
        disparities.append((moved @ unit / np.linalg.norm(baseline))[close])
        residuals.append(across[close])
    return RowMatches(np.concatenate(disparities), np.concatenate(residuals))
