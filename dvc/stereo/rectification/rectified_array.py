"""Views of a planar array from plain or calibrated pictures, with the range of their disparities."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path

import numpy as np

from dvc.array_files import MAX_LABELS, read_pictures
from dvc.arrays import Floats
from dvc.errors import ConfigError, DvcError
from dvc.geometry.calibrated_cameras import LARGEST, Camera
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.camera_estimation import Features
from dvc.geometry.camera_files import AUTO, load_cameras
from dvc.stereo.rectification.camera_lattice import assign_positions, fit_lattice, mean_orientation
from dvc.stereo.rectification.rectified_space import MAX_RESAMPLED_SIDE, Rectification, cropped, resample
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
USUAL_PARALLAX = 0.25
"""Parallax of the nearest point between the farthest cameras if depth is unknown, in picture widths."""
POSITION_TOLERANCE_PX = 0.25
"""Largest change of parallax from snapping cameras to the lattice."""
MAX_EPIPOLAR_PX = 1.5
"""Largest distance of matches from their epipolar lines."""
MIN_REFINING_MATCHES = 30
GOOD_ROWS_PX = 0.5
"""Error of rows of a calibration that is not refined."""
MIN_GAIN = 0.1
"""Smallest relative gain in rms error of a refinement."""
_NOISE_PX = 0.3
_SIGMAS = np.array([np.radians(0.3)] * 4 + [0.005])
"""Usual errors of two tilts and rolls, in radians, and of half the log of the ratio of focal lengths."""
_MAX_SIGMAS = 6.0


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
    if max(rectification.size) > MAX_RESAMPLED_SIDE:
        size = "x".join(map(str, rectification.size))
        raise ConfigError(
            f"rectified views would have {size} pixels, sides of at most {MAX_RESAMPLED_SIDE} are accepted"
        )
    rectified = []
    for index, (path, picture) in enumerate(zip(paths, pictures, strict=True)):
        image, valid = resample(rectification, index, picture)
        mask = None if valid.all() else valid
        rectified.append(ArrayView(Path(path).stem, image, rectification.positions[index], mask))
        advance(1)
    limits = matches = None
    shift, d = rectification.disparity_shift, rectification.disparities(views.points)
    if (d := d[np.isfinite(d) & (d > -shift)]).size:
        limits = range_of(d) if d.size >= MIN_MATCHES else (float(d.min()), float(d.max()))
    if features:
        matches = row_matches(rectification.positions, features, rectification.rectified_points)
        limits = limits or range_of_matches(matches)
    width = max(camera.size[0] for camera in calibrated)
    usual = -shift, usual_disparity(np.array(rectification.positions), width) - shift
    off_plane_px = rectification.off_plane_px(*(limits or usual))
    worst = int(off_plane_px.argmax())
    if off_plane_px[worst] > MAX_OFF_PLANE_PX:
        raise DvcError(
            f"the cameras are not in a plane: {calibrated[worst].name} is off by up to "
            f"{off_plane_px[worst]:.1f} px of parallax, at most {MAX_OFF_PLANE_PX:g} px are accepted"
        )
    array, refined = CameraArray(tuple(rectified)), calibrated != views.cameras
    return RectifiedArray(array, rectification, limits, off_plane_px, matches, refined)


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


def rectify(
    cameras: Sequence[Camera],
    positions: Sequence[LatticePosition] | None = None,
    points: Floats | None = None,
) -> Rectification:
    """Find the rectified space of cameras, and the crop with the best overlap of their pictures.

    Parameters
    ----------
    cameras : sequence of Camera
        At least two.
    positions : sequence of LatticePosition, optional
        Their positions, up to the signs of m and n; by default from the centres. Centres off the lattice
        get real-valued positions.
    points : ndarray of shape (N, 3), float64, optional
        Points of the scene, for cameras that are slightly off a plane.

    Returns
    -------
    Rectification
        With the cameras in this order.

    Raises
    ------
    ConfigError
        If the cameras span no lattice, or a picture looks along the plane of the cameras.
    """
    if len(cameras) < 2:
        raise ConfigError("at least two views are needed")
    centres = np.stack([camera.centre for camera in cameras])
    if np.ptp(centres, axis=0).max() < 1.0 / LARGEST:
        raise ConfigError("the cameras are at one point: nothing has parallax")
    orientation = mean_orientation([camera.R for camera in cameras])
    if positions is None:
        lattice, coordinates = assign_positions(centres, orientation)
    else:
        given = np.array(positions, dtype=np.float64)
        _check_apart(cameras, given, "have one position")
        lattice, coordinates = fit_lattice(centres, given, orientation)
    focal = float(np.mean([camera.focal_length_px for camera in cameras]))
    width = max(camera.size[0] for camera in cameras)
    lowest, highest = 0.0, usual_disparity(coordinates, width)
    if points is not None and len(points):
        distance = lattice.coordinates(points)[:, 2]
        if np.any(distance > 0.0):
            lowest, highest = np.quantile(focal / distance[distance > 0.0], QUANTILES)
    actual = lattice.coordinates(centres)[:, :2]
    if np.abs(actual - coordinates).max() > POSITION_TOLERANCE_PX / highest:
        coordinates = actual
    _check_apart(cameras, coordinates, "were taken from one point")
    middle, on_lattice = float(0.5 * (lowest + highest)), starmap(LatticePosition, coordinates.tolist())
    return cropped(Rectification(tuple(cameras), lattice, tuple(on_lattice), focal, middle))


def _check_apart(cameras: Sequence[Camera], points: Floats, message: str) -> None:
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.diag(np.full(len(points), np.inf))
    first, second = np.unravel_index(apart.argmin(), apart.shape)
    if apart[first, second] <= 1e-3 * np.ptp(points, axis=0).max():
        raise ConfigError(f"{cameras[first].name} and {cameras[second].name} {message}")


def usual_disparity(positions: Floats, width: int) -> float:
    """Return the disparity with a parallax of `USUAL_PARALLAX` between the farthest cameras."""
    return USUAL_PARALLAX * width / float(np.hypot(*np.ptp(positions, axis=0)))


def refined_pair(cameras: Sequence[Camera], first: Floats, second: Floats) -> tuple[Camera, ...]:
    """Tilt and roll two cameras, and balance their focal lengths, until the rows of matches agree."""
    import pycolmap
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    options = pycolmap.RANSACOptions(max_error=MAX_EPIPOLAR_PX, random_seed=0, num_threads=1)
    answer = pycolmap.estimate_fundamental_matrix(first, second, options) if len(first) >= 8 else None
    inliers = np.zeros(0, np.bool_) if answer is None else np.asarray(answer["inlier_mask"], np.bool_)
    if np.count_nonzero(inliers) < MIN_REFINING_MATCHES:
        return tuple(cameras)
    first, second = first[inliers], second[inliers]
    bare = rectify(cameras, (LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)))

    def _corrected(sigmas: Floats) -> tuple[Camera, ...]:
        correction = sigmas * _SIGMAS
        corrected = []
        turns = zip(cameras, correction[:4].reshape(2, 2), (1.0, -1.0), strict=True)
        for camera, (tilt, roll), sign in turns:
            R = Rotation.from_rotvec([tilt, 0.0, roll]).as_matrix() @ camera.R
            scale = float(np.exp(sign * correction[4]))
            K = camera.K * np.array([[scale, scale, 1.0], [1.0, scale, 1.0], [1.0, 1.0, 1.0]])
            corrected.append(replace(camera, K=K, R=R, t=-R @ camera.centre))
        return tuple(corrected)

    def _rows(sigmas: Floats) -> Floats:
        changed = replace(bare, cameras=_corrected(sigmas))
        return np.asarray((changed.rectified_points(0, first) - changed.rectified_points(1, second))[:, 1])

    def _residuals(sigmas: Floats) -> Floats:
        return np.concatenate([_rows(sigmas), _NOISE_PX * sigmas])

    solved = least_squares(_residuals, np.zeros(5), max_nfev=100).x
    before, after = (float(np.sqrt((_rows(sigmas) ** 2).mean())) for sigmas in (np.zeros(5), solved))
    gains = before > GOOD_ROWS_PX and after < (1.0 - MIN_GAIN) * before
    return _corrected(solved) if gains and np.abs(solved).max() <= _MAX_SIGMAS else tuple(cameras)
