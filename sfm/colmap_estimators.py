"""Two steps of the pipeline by COLMAP's estimators: weak calibration, and a Euclidean pair of cameras.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX, PixelFrame, homogeneous, project
from dvc.geometry.triangulation import triangulate_depth
from sfm.cameras.projective_basis import CAMERA_NORM
from sfm.correspondences import outliers
from sfm.estimation.epipolar import (
    fundamental_from_camera,
    fundamental_to_pixels,
    sampson_distances,
    unit_norm,
)
from sfm.estimation.weak_calibration import WeakCalibration
from sfm.reconstruction_settings import SfmSettings
from sfm.scene_model import CameraPair, Correspondences

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOCAL_LENGTHS = tuple(np.geomspace(0.6, 3.0, 9))
"""Focal lengths tried, in units of the longer side of the image."""


def weak_calibration(matches: Correspondences, settings: SfmSettings, seed: int) -> WeakCalibration:
    """Find the fundamental matrix by COLMAP's LO-RANSAC."""
    found = _fundamental(matches, settings.colmap_max_error_px, seed)
    if found is None or np.count_nonzero(found[1]) < settings.weak_calibration.min_num_inliers:
        reason = f"COLMAP finds no epipolar geometry in {len(matches)} correspondences"
        return WeakCalibration.missing(len(matches), reason)
    fundamental, inliers = found
    residuals = sampson_distances(fundamental, matches.first, matches.second)
    noise_px = float(np.sqrt((residuals[inliers] ** 2).mean()))
    return WeakCalibration(fundamental, inliers, residuals, noise_px, 0, "")


def _fundamental(matches: Correspondences, max_error_px: float, seed: int) -> tuple[Floats, Mask] | None:
    import pycolmap

    if len(matches) < 8:
        return None
    ransac = _ransac(max_error_px, seed)
    answer = pycolmap.estimate_fundamental_matrix(matches.first, matches.second, ransac)
    if answer is None:
        return None
    fundamental = np.asarray(answer["F"], dtype=np.float64)
    if not np.isfinite(fundamental).all() or not fundamental.any():
        return None
    return unit_norm(fundamental), np.asarray(answer["inlier_mask"], dtype=bool)


def camera_pair(matches: Correspondences, frame: PixelFrame, settings: SfmSettings, seed: int) -> CameraPair:
    """Find the relative pose, and of several focal lengths the one under which the points agree best."""
    max_error_px = settings.colmap_max_error_px
    best, fundamental, best_cost = None, np.zeros((3, 3)), np.inf
    for ratio in FOCAL_LENGTHS:
        camera = _camera(matches, frame, float(ratio), _ransac(max_error_px, seed))
        if camera is None:
            continue
        candidate = unit_norm(fundamental_to_pixels(fundamental_from_camera(camera), frame))
        squared = sampson_distances(candidate, matches.first, matches.second) ** 2
        cost = float(np.minimum(squared, max_error_px**2).sum())
        if cost < best_cost:
            best, fundamental, best_cost = camera, candidate, cost
    if best is None:
        return CameraPair.missing(len(matches), "COLMAP finds no relative pose")
    camera = best * (CAMERA_NORM / np.linalg.norm(best))
    kept = _agreeing(matches, camera, frame, settings.outliers.max_reprojection_px)
    return CameraPair(camera, fundamental, kept)


def _agreeing(matches: Correspondences, camera: Floats, frame: PixelFrame, limit_px: float) -> Mask:
    """Tell which points are before both cameras and project near where they are seen."""
    first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    depth_first, depth_second = triangulate_depth(first, camera, second)
    finite = np.isfinite(depth_first) & np.isfinite(depth_second)
    in_front = finite & (depth_first > 0) & (depth_second > 0)
    depths = np.where(in_front, depth_first, 1.0)
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(matches))])
    projected = frame.to_pixels(project(camera, points)[0])
    return in_front & outliers.reprojection(matches.second, projected, limit_px)


def _ransac(max_error_px: float, seed: int) -> Any:
    import pycolmap

    return pycolmap.RANSACOptions(max_error=max_error_px, random_seed=seed, num_threads=1)


def _camera(matches: Correspondences, frame: PixelFrame, ratio: float, ransac: Any) -> Floats | None:
    """Find the second camera for a focal length in units of the longer side of the image."""
    import pycolmap

    if len(matches) < 8:
        return None
    size = {"width": frame.width_px, "height": frame.height_px}
    focal_length_px = ratio * frame.scale_px
    parameters = [focal_length_px, 0.5 * frame.width_px, 0.5 * frame.height_px]
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", params=parameters, **size)
    first, second = matches.first + COLMAP_FIRST_PIXEL_PX, matches.second + COLMAP_FIRST_PIXEL_PX
    answer = pycolmap.estimate_relative_pose(camera, first, camera, second, ransac)
    if answer is None:
        return None
    pose = answer["cam2_from_cam1"]
    refined = pycolmap.refine_relative_pose(pose, camera, first, camera, second, answer["inlier_mask"])
    if refined is not None:
        pose = refined["cam2_from_cam1"]
    second_from_first = np.asarray(pose.matrix(), dtype=np.float64)
    k = np.array([focal_length_px, focal_length_px, frame.scale_px]) / frame.scale_px
    found = np.column_stack([second_from_first[:, :3] * k[:, None] / k, second_from_first[:, 3] * k])
    return found if np.isfinite(found).all() and found[:, 3].any() else None
