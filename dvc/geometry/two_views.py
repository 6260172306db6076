"""Cameras of two plain pictures: the relative pose and the focal length on which most matches agree."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dvc.errors import DvcError
from dvc.geometry.calibrated_cameras import CalibratedViews, Camera
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from dvc.geometry.feature_matching import Features

Floats = NDArray[np.float64]
Size = tuple[int, int]

FOCAL_LENGTHS = 0.6, 0.85, 1.2, 1.7, 2.4
"""From which the focal length is looked for, in units of the longer side of the picture."""
USUAL_FOCAL_LENGTH, FOCAL_SIGMA = 1.0, 0.4
"""Where lenses mostly are, and the natural logarithm of how far from it."""
NOISE_PX = 0.5
"""Of matches that are right, across their epipolar lines; those farther away have less weight."""
MAX_ERROR_PX = 1.5
MIN_MATCHES = 30
SEED = 0


@dataclass(frozen=True, eq=False)
class _Pose:
    """The second camera, where the first is ``[I | 0]``."""

    R: Floats
    t: Floats  # of length 1
    focal_length: float  # in units of the longer side

    def cameras(self, names: Sequence[str], size: Size) -> tuple[Camera, Camera]:
        K = _intrinsics(size, self.focal_length)
        first = Camera(names[0], K, np.eye(3), np.zeros(3), size)
        return first, Camera(names[1], K, self.R, self.t, size)


def two_views(
    names: Sequence[str], pictures: Sequence[NDArray[np.uint8]], features: Sequence[Features] = ()
) -> CalibratedViews:
    """Estimate the cameras of two pictures that one camera, or one kind of camera, has taken."""
    height, width = pictures[0].shape[:2]
    first, second = features or [Features(picture) for picture in pictures]
    return cameras_of_matches(names, (width, height), *first.match(second))


def cameras_of_matches(names: Sequence[str], size: Size, first: Floats, second: Floats) -> CalibratedViews:
    """Estimate the cameras of two pictures from the points that they share."""
    starts = [_consensus(first, second, size, ratio) for ratio in FOCAL_LENGTHS]
    found = [_agreed(start, first, second, size) for start in starts if start is not None]
    if not found:
        raise DvcError(
            f"the cameras of these two views cannot be estimated: {len(first)} points match, "
            "too few of them consistently; give them by --cameras FILE"
        )
    pose = min(found, key=lambda entry: entry[1])[0]
    inliers = np.abs(_sampson_distances(pose, size, first, second)) < MAX_ERROR_PX
    views = []
    for t in (pose.t, -pose.t):  # epipolar lines do not tell which; points lie before the cameras
        cameras = replace(pose, t=t).cameras(names, size)
        views.append(CalibratedViews(cameras, _triangulated(cameras, first[inliers], second[inliers])))
    return max(views, key=lambda found: len(found.points))


def _intrinsics(size: Size, ratio: float) -> Floats:
    focal = ratio * max(size)
    return np.array([[focal, 0.0, 0.5 * (size[0] - 1)], [0.0, focal, 0.5 * (size[1] - 1)], [0.0, 0.0, 1.0]])


def _consensus(first: Floats, second: Floats, size: Size, ratio: float) -> _Pose | None:
    """Return the pose with most inliers under a focal length."""
    import pycolmap

    if len(first) < MIN_MATCHES:
        return None
    parameters = [ratio * max(size), 0.5 * size[0], 0.5 * size[1]]
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", params=parameters, width=size[0], height=size[1])
    ransac = pycolmap.RANSACOptions(max_error=MAX_ERROR_PX, random_seed=SEED, num_threads=1)
    answer = pycolmap.estimate_relative_pose(
        camera, first + COLMAP_FIRST_PIXEL_PX, camera, second + COLMAP_FIRST_PIXEL_PX, ransac
    )
    if answer is None or np.count_nonzero(answer["inlier_mask"]) < MIN_MATCHES:
        return None
    pose = np.asarray(answer["cam2_from_cam1"].matrix(), dtype=np.float64)
    return _Pose(pose[:, :3], pose[:, 3] / np.linalg.norm(pose[:, 3]), ratio)


def _agreed(start: _Pose, first: Floats, second: Floats, size: Size) -> tuple[_Pose, float]:
    """Move a pose and its focal length to where all matches agree best; return it, and what is left."""
    across = np.linalg.svd(start.t[:, None])[0][:, 1:]

    def _moved(x: Floats) -> _Pose:
        t = start.t + across @ x[3:5]
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ start.R
        return _Pose(R, t / np.linalg.norm(t), start.focal_length * float(np.exp(x[5])))

    def _left(x: Floats) -> Floats:
        pose = _moved(x)
        distance = _sampson_distances(pose, size, first, second) / NOISE_PX
        unusual = np.log(pose.focal_length / USUAL_FOCAL_LENGTH) / FOCAL_SIGMA
        return np.append(np.sign(distance) * np.sqrt(np.log1p(distance**2)), unusual)

    solved = least_squares(_left, np.zeros(6), max_nfev=100)
    return _moved(solved.x), float(solved.cost)


def _sampson_distances(pose: _Pose, size: Size, first: Floats, second: Floats) -> Floats:
    """Return signed distances of matches from their epipolar lines, to first order, in pixels."""
    inverse = np.linalg.inv(_intrinsics(size, pose.focal_length))
    F = inverse.T @ np.cross(np.eye(3), pose.t) @ pose.R @ inverse
    a, b = (np.column_stack([points, np.ones(len(points))]) for points in (first, second))
    lines, back = a @ F.T, b @ F
    gradient = (lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return np.asarray((b * lines).sum(axis=1) / np.sqrt(np.maximum(gradient, 1e-300)))


def _triangulated(cameras: tuple[Camera, Camera], first: Floats, second: Floats) -> Floats:
    """Return the points of the world that lie before both cameras."""
    found = cv2.triangulatePoints(cameras[0].projection, cameras[1].projection, first.T, second.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = (found[:3] / found[3]).T
    depths = [points @ camera.R[2] + camera.t[2] for camera in cameras]
    kept = np.isfinite(points).all(axis=1) & (depths[0] > 0.0) & (depths[1] > 0.0)
    return np.asarray(points[kept], dtype=np.float64)
