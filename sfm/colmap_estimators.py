"""COLMAP's estimators: the fundamental matrix, relative poses, and a pair of cameras of unknown focal length.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

from typing import Any

import numpy as np

from dvc.arrays import Floats, Mask
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
from sfm.estimation.weak_calibration import MIN_NUM_INLIERS, WeakCalibration
from sfm.scene_model import CameraPair, Correspondences

FOCAL_LENGTHS = tuple(np.geomspace(0.6, 3.0, 9))
"""Focal lengths to try, in units of the longer side of the image."""
MIN_NUM_POINTS = 8
MAX_ERROR_PX = 1.0
"""Largest error of an inlier."""


def pinhole_camera(K: Floats) -> Any:
    """Return COLMAP's camera of square pixels with the principal point in the middle of the image."""
    import pycolmap

    parameters = [K[0, 0], K[0, 2] + COLMAP_FIRST_PIXEL_PX, K[1, 2] + COLMAP_FIRST_PIXEL_PX]
    width, height = round(2 * parameters[1]), round(2 * parameters[2])
    return pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=parameters, camera_id=1)


def relative_pose(camera: Any, first: Floats, second: Floats, ransac: Any) -> tuple[Floats, Mask] | None:
    """Return the pose [R | t] of the second camera and a mask of inliers, for points in COLMAP's pixels."""
    import pycolmap

    answer = pycolmap.estimate_relative_pose(camera, first, camera, second, ransac)
    if answer is None:
        return None
    rigid, mask = answer["cam2_from_cam1"], answer["inlier_mask"]
    refined = pycolmap.refine_relative_pose(rigid, camera, first, camera, second, mask)
    rigid = rigid if refined is None else refined["cam2_from_cam1"]
    return np.asarray(rigid.matrix(), np.float64), np.asarray(mask, dtype=bool)


def weak_calibration(matches: Correspondences, seed: int) -> WeakCalibration:
    """Estimate the fundamental matrix by COLMAP's LO-RANSAC."""
    import pycolmap

    reason = f"COLMAP finds no epipolar geometry in {len(matches)} correspondences"
    answer = None
    if len(matches) >= MIN_NUM_POINTS:
        answer = pycolmap.estimate_fundamental_matrix(matches.first, matches.second, _ransac(seed))
    if answer is None:
        return WeakCalibration.missing(len(matches), reason)
    fundamental = np.asarray(answer["F"], dtype=np.float64)
    inliers = np.asarray(answer["inlier_mask"], dtype=bool)
    is_valid = np.isfinite(fundamental).all() and fundamental.any()
    if not is_valid or np.count_nonzero(inliers) < MIN_NUM_INLIERS:
        return WeakCalibration.missing(len(matches), reason)
    fundamental = unit_norm(fundamental)
    residuals = sampson_distances(fundamental, matches.first, matches.second)
    noise_px = float(np.sqrt((residuals[inliers] ** 2).mean()))
    return WeakCalibration(fundamental, inliers, residuals, noise_px, "")


def camera_pair(matches: Correspondences, frame: PixelFrame, seed: int) -> CameraPair:
    """Estimate the relative pose with the focal length under which the points agree best."""
    best, fundamental, best_cost = None, np.zeros((3, 3)), np.inf
    for ratio in FOCAL_LENGTHS if len(matches) >= MIN_NUM_POINTS else ():
        focal = float(ratio) * frame.scale_px
        x, y = 0.5 * (frame.width_px - 1), 0.5 * (frame.height_px - 1)
        K = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1]])
        first, second = matches.first + COLMAP_FIRST_PIXEL_PX, matches.second + COLMAP_FIRST_PIXEL_PX
        answer = relative_pose(pinhole_camera(K), first, second, _ransac(seed))
        if answer is None:
            continue
        pose, k = answer[0], np.array([focal, focal, frame.scale_px]) / frame.scale_px
        camera = np.column_stack([pose[:, :3] * k[:, None] / k, pose[:, 3] * k])
        if not np.isfinite(camera).all() or not camera[:, 3].any():
            continue
        candidate = unit_norm(fundamental_to_pixels(fundamental_from_camera(camera), frame))
        squared = sampson_distances(candidate, matches.first, matches.second) ** 2
        cost = float(np.minimum(squared, MAX_ERROR_PX**2).sum())
        if cost < best_cost:
            best, fundamental, best_cost = camera, candidate, cost
    if best is None:
        return CameraPair.missing(len(matches), "COLMAP finds no relative pose")
    camera = best * (CAMERA_NORM / np.linalg.norm(best))
    # Points that agree lie in front of both cameras and project near their image points.
    first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    depth_first, depth_second = triangulate_depth(first, camera, second)
    in_front = np.isfinite(depth_first) & np.isfinite(depth_second) & (depth_first > 0) & (depth_second > 0)
    depths = np.where(in_front, depth_first, 1.0)
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(matches))])
    projected = frame.to_pixels(project(camera, points)[0])
    return CameraPair(camera, fundamental, in_front & outliers.reprojection(matches.second, projected))


def _ransac(seed: int) -> Any:
    import pycolmap

    return pycolmap.RANSACOptions(max_error=MAX_ERROR_PX, random_seed=seed, num_threads=1)
