"""From plain or calibrated pictures to the views of a planar array, and the disparities that they have."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS, read_pictures
from dvc.errors import ConfigError, DvcError
from dvc.multiview.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.stereo.rectification.camera_files import AUTO, load_cameras
from dvc.stereo.rectification.cameras import CalibratedViews
from dvc.stereo.rectification.feature_matching import Features
from dvc.stereo.rectification.rectified_space import Rectification
from dvc.stereo.rectification.rectify import rectify, usual_disparity
from dvc.stereo.rectification.refinement import refined_pair
from dvc.stereo.rectification.resampling import resample
from dvc.stereo.surfaces.occupancy import neighbours

Floats = NDArray[np.float64]

MAX_OFF_PLANE_PX = 10.0
"""How far (2.5) may fail at the corners of pictures whose cameras are not quite in a plane."""
ROW_TOLERANCE_PX = 2.0
"""Matches farther than this from where (2.5) allows them are wrong."""
QUANTILES = 0.01, 0.99
FAR_MARGIN, NEAR_MARGIN, MARGIN_PX = 0.15, 0.35, 1.0
"""Added to the range of known disparities: in parts of it, and in pixels. The nearest points are few."""
MIN_MATCHES = 20
MIN_LABELS = 16
MOST_OUTSIDE = 0.9
"""Share of matches outside a range of disparities that shows it to be wrong."""
_MAX_PARTNERS = 8


@dataclass(frozen=True, eq=False)
class RowMatches:
    """Points that the reference view and others share.

    Attributes
    ----------
    disparities : ndarray of shape (N,), float64
        Of matches that agree with (2.5), in pixels per unit of m.
    residuals_px : ndarray of shape (N,), float64
        How far across the direction of parallax they lie from where (2.5) has them.
    """

    disparities: Floats
    residuals_px: Floats

    @property
    def rms_px(self) -> float | None:
        """Root of the mean squared residual; None without matches."""
        return float(np.sqrt((self.residuals_px**2).mean())) if self.residuals_px.size else None


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
        As for `dvc.stereo.rectification.camera_files.load_cameras`.
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
    views = load_cameras(cameras, paths, pictures)
    features = []
    if with_matches or len(pictures) == 2 or not len(views.points):
        features = [Features(picture) for picture in pictures]
    given = views.cameras
    if len(pictures) == 2 and not keep_cameras and str(cameras) != AUTO:
        refined = refined_pair(given, *features[0].match(features[1]))
        views = CalibratedViews(refined, views.points)
    rectification = rectify(views.cameras, positions, views.points)
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
        found = found or _range_of_matches(matches)
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
    return _range(disparities)


def _range_of_matches(matches: RowMatches) -> tuple[float, float] | None:
    return _range(matches.disparities) if len(matches.disparities) >= MIN_MATCHES else None


def found_labels(array: CameraArray) -> DisparityLabels | None:
    """Return the disparities to try for views that are rectified already, from points that they share.

    Parameters
    ----------
    array : CameraArray
        The views.

    Returns
    -------
    DisparityLabels or None
        None if too few points match.
    """
    positions, features = [view.position for view in array], [Features(view.image) for view in array]
    found = _range_of_matches(row_matches(positions, features))
    return None if found is None else suggested_labels(*found)


def check_disparities(array: CameraArray, labels: DisparityLabels) -> None:
    """Compare disparities to try with those of points that the reference view and its neighbours share.

    Parameters
    ----------
    array : CameraArray
        Views that are rectified already.
    labels : DisparityLabels
        Disparities to try.

    Raises
    ------
    ConfigError
        If nearly all points lie outside the range, as where views are in the wrong order, or mirrored.
    """
    reference = array.reference
    own = Features(array[reference].image)
    for index in neighbours(array, reference).all:
        pair = array[reference], array[index]
        origin, place = (view.position for view in pair)
        baseline = LatticePosition(place.m - origin.m, place.n - origin.n)
        found = row_matches([LatticePosition(0.0, 0.0), baseline], [own, Features(pair[1].image)]).disparities
        slack = MARGIN_PX / float(np.hypot(*baseline))
        outside = (found < labels.lowest - slack) | (found > labels.highest + slack)
        if len(found) < MIN_MATCHES or outside.mean() < MOST_OUTSIDE:
            continue
        low, high = _range(found)
        raise ConfigError(
            f"points that {pair[0].name} and {pair[1].name} share have disparities from {low:.3g} to "
            f"{high:.3g} px, not {labels.lowest:g} to {labels.highest:g}: the range, or the order or the "
            "positions of the views are wrong"
        )


def _range(disparities: Floats) -> tuple[float, float]:
    lowest, highest = np.quantile(disparities, QUANTILES)
    return float(lowest), float(highest)


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


def suggested_labels(lowest: float, highest: float) -> DisparityLabels:
    """Return disparities to try where those of some points are known.

    Parameters
    ----------
    lowest, highest : float
        Range of the known ones.

    Returns
    -------
    DisparityLabels
        With margins on both sides, in steps of 1 px, or of the
        largest power of 1/2 that gives `MIN_LABELS` disparities.
    """
    low = lowest - FAR_MARGIN * (highest - lowest) - MARGIN_PX
    high = highest + NEAR_MARGIN * (highest - lowest) + MARGIN_PX
    step = min(1.0, 2.0 ** math.floor(math.log2((high - low) / MIN_LABELS)))
    step = max(step, 2.0 ** math.ceil(math.log2((high - low) / (MAX_LABELS - 2))))
    first, last = math.floor(low / step), math.ceil(high / step)
    return DisparityLabels(first * step, step, last - first + 1)


def row_matches(
    positions: Sequence[LatticePosition],
    features: Sequence[Features],
    placed: Callable[[int, Floats], Floats] = lambda _, points: points,
) -> RowMatches:
    """Match the reference view with those nearest to it.

    Parameters
    ----------
    positions : sequence of LatticePosition
        Of the views.
    features : sequence of Features
        Of their pictures.
    placed : callable, optional
        Takes the number of a view and points (N, 2) of its picture, returns them in the rectified one.

    Returns
    -------
    RowMatches
        Matches within `ROW_TOLERANCE_PX` of (2.5).
    """
    places = np.array(positions)
    distance = np.linalg.norm(places, axis=1)
    reference = int(distance.argmin())
    nearest = np.argsort(np.linalg.norm(places - places[reference], axis=1), kind="stable")
    disparities, residuals = [np.zeros(0)], [np.zeros(0)]
    for index in nearest[1 : 1 + _MAX_PARTNERS]:
        here, there = features[reference].match(features[index])
        moved = placed(reference, here) - placed(int(index), there)
        baseline = places[index] - places[reference]
        unit = baseline / np.linalg.norm(baseline)
        across = moved @ np.array([-unit[1], unit[0]])
        kept = np.abs(across) <= ROW_TOLERANCE_PX
        disparities.append((moved @ unit / np.linalg.norm(baseline))[kept])
        residuals.append(across[kept])
    return RowMatches(np.concatenate(disparities), np.concatenate(residuals))
