"""Two steps of the pipeline by COLMAP's estimators: weak calibration, and a Euclidean pair of cameras.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module alone converts.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import PixelFrame, homogeneous, project
from dvc.multiview.triangulation import triangulate_depth
from sfm.correspondences import outliers
from sfm.estimation.epipolar import (
    fundamental_from_camera,
    fundamental_to_pixels,
    sampson_distances,
    unit_norm,
)
from sfm.estimation.weak_calibration import WeakCalibration
from sfm.model import CameraPair, Correspondences
from sfm.settings import SfmSettings

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOCAL_LENGTHS = tuple(np.geomspace(0.6, 3.0, 9))
"""Focal lengths tried, in units of the longer side of the image."""
_PIXEL_CENTRE = 0.5


def weak_calibration(
    matches: Correspondences, rng: np.random.Generator, settings: SfmSettings
) -> WeakCalibration:
    """Find the fundamental matrix by COLMAP's LO-RANSAC.

    Parameters
    ----------
    matches : Correspondences
        Outliers included.
    rng : Generator
        Source of randomness.
    settings : SfmSettings
        Thresholds.

    Returns
    -------
    WeakCalibration
        The matrix, or the reason why there is none.
    """
    found = estimate_fundamental(matches, settings.colmap_max_error_px, _seed(rng))
    if found is None or np.count_nonzero(found[1]) < settings.weak_calibration.min_num_inliers:
        reason = f"COLMAP finds no epipolar geometry in {len(matches)} correspondences"
        return WeakCalibration.missing(len(matches), reason)
    fundamental, inliers = found
    residuals = sampson_distances(fundamental, matches.first, matches.second)
    noise_px = float(np.sqrt((residuals[inliers] ** 2).mean()))
    return WeakCalibration(fundamental, inliers, residuals, noise_px, 0, "")


def camera_pair(
    matches: Correspondences,
    calibration: WeakCalibration,
    frame: PixelFrame,
    rng: np.random.Generator,
    settings: SfmSettings,
) -> CameraPair:
    """Find focal length and relative pose, and refine them, by COLMAP.

    Parameters
    ----------
    matches : Correspondences
        Reliable points, in pixels.
    calibration : WeakCalibration
        Not used: the pose is estimated from the points.
    frame : PixelFrame
        Size of the images.
    rng : Generator
        Source of randomness.
    settings : SfmSettings
        Thresholds.

    Returns
    -------
    CameraPair
        The camera, or the reason why there is none.
    """
    del calibration
    pair = estimate_pair(matches, frame, settings.colmap_max_error_px, _seed(rng))
    if pair is None:
        return CameraPair.missing(len(matches), "COLMAP finds no relative pose")
    camera = pair.second_camera
    first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    depth_first, depth_second = triangulate_depth(first, camera, second)
    finite = np.isfinite(depth_first) & np.isfinite(depth_second)
    in_front = finite & (depth_first > 0) & (depth_second > 0)
    depths = np.where(in_front, depth_first, 1.0)
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(matches))])
    projected = frame.to_pixels(project(camera, points)[0])
    near = outliers.reprojection(matches.second, projected, settings.outliers.max_reprojection_px)
    return CameraPair(camera, pair.fundamental, in_front & near)


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31 - 1))


@dataclass(frozen=True, eq=False)
class EuclideanPair:
    """Two calibrated cameras.

    Attributes
    ----------
    focal_length_px : float
        Focal length of both, in pixels; the principal point is the centre of the image.
    second_camera : ndarray of shape (3, 4), float64
        Projection matrix ``K [R | t] diag(K, 1)^-1`` of the second camera in normalised coordinates, for a
        first camera ``[I | 0]``; Frobenius norm sqrt(3).
    fundamental : ndarray of shape (3, 3), float64
        F in pixels, unit Frobenius norm.
    """

    focal_length_px: float
    second_camera: Floats
    fundamental: Floats


def estimate_fundamental(
    matches: Correspondences, max_error_px: float, seed: int
) -> tuple[Floats, Mask] | None:
    """Estimate F by COLMAP's LO-RANSAC.

    Parameters
    ----------
    matches : Correspondences
        Outliers included.
    max_error_px : float
        Largest error of an inlier, in pixels.
    seed : int
        Of the random samples.

    Returns
    -------
    F : ndarray of shape (3, 3), float64
        Fundamental matrix in pixels, unit Frobenius norm.
    inliers : ndarray of shape (N,), bool
        Correspondences that agree with it.
        None instead of both where nothing can be estimated.
    """
    import pycolmap

    if len(matches) < 8:
        return None
    options = _ransac(max_error_px, seed)
    answer = pycolmap.estimate_fundamental_matrix(matches.first, matches.second, options)
    if answer is None:
        return None
    fundamental = np.asarray(answer["F"], dtype=np.float64)
    if not np.isfinite(fundamental).all() or not fundamental.any():
        return None
    return unit_norm(fundamental), np.asarray(answer["inlier_mask"], dtype=bool)


def estimate_pair(
    matches: Correspondences,
    frame: PixelFrame,
    max_error_px: float,
    seed: int,
) -> EuclideanPair | None:
    """Estimate the relative pose, and of several focal lengths the one under which the points agree best.

    Parameters
    ----------
    matches : Correspondences
        Without outliers, or with few.
    frame : PixelFrame
        Size of the images.
    max_error_px : float
        Largest error of an inlier, in pixels.
    seed : int
        Of the random samples.

    Returns
    -------
    EuclideanPair or None
        None where nothing can be estimated.
    """
    best, best_cost = None, np.inf
    for ratio in FOCAL_LENGTHS:
        pair = _pose(matches, frame, float(ratio) * frame.scale_px, max_error_px, seed)
        if pair is None:
            continue
        squared = sampson_distances(pair.fundamental, matches.first, matches.second) ** 2
        cost = float(np.minimum(squared, max_error_px**2).sum())
        if cost < best_cost:
            best, best_cost = pair, cost
    return best


def _ransac(max_error_px: float, seed: int) -> Any:
    import pycolmap

    return pycolmap.RANSACOptions(max_error=max_error_px, random_seed=seed, num_threads=1)


def _pose(
    matches: Correspondences, frame: PixelFrame, focal_length_px: float, max_error_px: float, seed: int
) -> EuclideanPair | None:
    import pycolmap

    if len(matches) < 8:
        return None
    size = {"width": frame.width_px, "height": frame.height_px}
    parameters = [focal_length_px, 0.5 * frame.width_px, 0.5 * frame.height_px]
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", params=parameters, **size)
    first, second = matches.first + _PIXEL_CENTRE, matches.second + _PIXEL_CENTRE
    answer = pycolmap.estimate_relative_pose(camera, first, camera, second, _ransac(max_error_px, seed))
    if answer is None:
        return None
    pose = answer["cam2_from_cam1"]
    refined = pycolmap.refine_relative_pose(pose, camera, first, camera, second, answer["inlier_mask"])
    if refined is not None:
        pose = refined["cam2_from_cam1"]
    return _pair(np.asarray(pose.matrix(), dtype=np.float64), frame, focal_length_px)


def _pair(second_from_first: Floats, frame: PixelFrame, focal_length_px: float) -> EuclideanPair | None:
    ratio = focal_length_px / frame.scale_px
    k = np.array([ratio, ratio, 1.0])
    camera = np.column_stack([second_from_first[:, :3] * k[:, None] / k, second_from_first[:, 3] * k])
    if not np.isfinite(camera).all() or not camera[:, 3].any():
        return None
    fundamental = fundamental_to_pixels(fundamental_from_camera(camera), frame)
    camera *= np.sqrt(3.0) / np.linalg.norm(camera)
    return EuclideanPair(focal_length_px, camera, unit_norm(fundamental))
