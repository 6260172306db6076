"""Cameras of frames, points of the scene and their observations: triangulation, registration, adjustment.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dvc.arrays import Floats, Integers, Mask
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.colmap_estimators import pinhole_camera
from sfm.mapping.sequence_tracks import VisiblePoints

SEED = 0
MIN_ANGLE_DEG = 1.5
"""Least angle between the rays to a point; below it the depth is noise."""
MAX_ERROR_PX = 2.0
"""Largest reprojection error of a point that agrees with its track."""
NUM_STEPS = 4
"""Number of Gauss-Newton steps after the linear solution."""
MIN_DEPTH = 1e-9
LOSS_PX = 0.3
"""Error above which the robust loss is linear: about the error of a good track."""
MAX_STEPS = 50
MIN_INLIERS = 20
"""Least number of points that agree with a pose."""
MIN_INLIER_SHARE = 0.4
"""Least share of the points that agree with a pose."""
MAX_POSE_ERROR_PX = 3.0
"""Largest error of a point that agrees with a pose."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Positions of points in frames, one row each."""

    frames: Integers  # frame indices
    points: Integers  # point indices
    positions: Floats  # (x, y) in pixels

    def __getitem__(self, chosen: Mask | Integers) -> "Observations":
        """Return some of the rows."""
        return Observations(self.frames[chosen], self.points[chosen], self.positions[chosen])


@dataclass(eq=False)
class Structure:
    """A part of the scene during mapping."""

    K: Floats  # intrinsics of all frames
    poses: dict[int, Floats] = field(default_factory=dict)  # (3, 4) by frame index
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))  # nan: not triangulated

    @property
    def triangulated(self) -> Mask:
        """Mask of the points with a position."""
        return np.asarray(np.isfinite(self.points[:, 0]))


def observations(seen: Sequence[VisiblePoints], frames: Sequence[int]) -> Observations:
    """Collect the observations of some frames."""
    parts = [seen[index] for index in frames]
    numbers = np.repeat(np.asarray(frames, np.int64), [len(part.ids) for part in parts])
    ids = np.concatenate([np.empty(0, np.int64), *(part.ids for part in parts)])
    return Observations(numbers, ids, np.concatenate([np.empty((0, 2)), *(part.positions for part in parts)]))


def reprojection_errors(structure: Structure, seen: Observations) -> Floats:
    """Return errors in pixels; inf for points without a position or behind the camera."""
    poses = stacked(structure.poses, seen.frames)
    inside = np.einsum("nij,nj->ni", poses[:, :, :3], structure.points[seen.points]) + poses[:, :, 3]
    with np.errstate(invalid="ignore", divide="ignore"):
        image = inside @ structure.K.T
        offset = image[:, :2] / image[:, 2:] - seen.positions
        error = np.hypot(offset[:, 0], offset[:, 1])
    return np.where(np.isfinite(error) & (inside[:, 2] > MIN_DEPTH), error, np.inf)


def rays_through(K: Floats, positions: Floats) -> Floats:
    """Return the directions (x, y, 1) of pixel positions in the camera."""
    return np.column_stack([(positions - K[:2, 2]) / K[0, 0], np.ones(len(positions))])


def stacked(poses: dict[int, Floats], frames: Integers) -> Floats:
    """Return the poses (N, 3, 4) of registered frames."""
    if not len(frames):
        return np.empty((0, 3, 4))
    numbers, inverse = np.unique(frames, return_inverse=True)
    return np.stack([poses[int(number)] for number in numbers])[inverse]


def triangulate(structure: Structure, seen: Observations) -> tuple[Integers, Floats]:
    """Return indices and positions of well-determined points; observations that disagree are dropped once."""
    numbers, points, errors = _triangulate_all(structure, seen)
    order = np.lexsort((errors, seen.points))
    _, start, which, count = np.unique(
        seen.points[order], return_index=True, return_inverse=True, return_counts=True
    )
    median = np.empty(len(errors))  # lower median of the errors of the same point
    median[order] = errors[order][(start + (count - 1) // 2)[which]]
    agreeing = errors <= np.maximum(MAX_ERROR_PX, median)
    if not agreeing.all():
        seen = seen[agreeing]
        numbers, points, errors = _triangulate_all(structure, seen)
    _, which, count = np.unique(seen.points, return_inverse=True, return_counts=True)
    worst = np.zeros(len(numbers))
    np.maximum.at(worst, which, errors)
    rays = rays_through(structure.K, seen.positions)
    angles = widest_angles_deg(stacked(structure.poses, seen.frames), rays, which, len(numbers))
    good = (count >= 2) & (worst <= MAX_ERROR_PX) & (angles >= MIN_ANGLE_DEG)
    return numbers[good], points[good]


def _triangulate_all(structure: Structure, seen: Observations) -> tuple[Integers, Floats, Floats]:
    """Return indices and positions of points, and the error of every observation."""
    numbers, which = np.unique(seen.points, return_inverse=True)
    poses = stacked(structure.poses, seen.frames)
    rays = rays_through(structure.K, seen.positions)
    rows = rays[:, :2, None] * poses[:, 2:3] - poses[:, :2]
    normal = np.zeros((len(numbers), 4, 4))
    np.add.at(normal, which, np.einsum("nki,nkj->nij", rows, rows))
    homogeneous = np.linalg.eigh(normal)[1][:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = homogeneous[:, :3] / homogeneous[:, 3:]
    for _ in range(NUM_STEPS):  # Gauss-Newton
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inside = np.einsum("nij,nj->ni", poses[:, :, :3], points[which]) + poses[:, :, 3]
            image = inside[:, :2] / inside[:, 2:]
            jacobian = (poses[:, :2, :3] - image[:, :, None] * poses[:, 2:3, :3]) / inside[:, 2, None, None]
            residual = rays[:, :2] - image
        normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(normal, which, np.einsum("nki,nkj->nij", jacobian, jacobian))
        np.add.at(right, which, np.einsum("nki,nk->ni", jacobian, residual))
        usable = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        normal[~usable], right[~usable] = np.eye(3), np.nan
        normal += (1e-9 * np.einsum("nii->n", normal) + 1e-300)[:, None, None] * np.eye(3)
        points = np.asarray(points + np.linalg.solve(normal, right[:, :, None])[:, :, 0])
    candidate = replace(structure, points=points)
    renumbered = replace(seen, points=which.astype(np.int64))
    return numbers, points, reprojection_errors(candidate, renumbered)


def widest_angles_deg(poses: Floats, rays: Floats, which: Integers, count: int) -> Floats:
    """Return the largest angle between the ray of a point's first observation and its other rays."""
    world = np.einsum("nij,ni->nj", poses[:, :, :3], rays / np.linalg.norm(rays, axis=1, keepdims=True))
    first = np.full(count, len(which), np.int64)
    np.minimum.at(first, which, np.arange(len(which)))
    cosine = np.clip((world * world[first[which]]).sum(axis=1), -1.0, 1.0)
    least = np.ones(count)
    np.minimum.at(least, which, cosine)
    return np.degrees(np.arccos(least))


def register_frame(structure: Structure, frame: int, seen: Observations) -> Floats | None:
    """Estimate the pose of a frame from the points it sees; None if too few agree."""
    import pycolmap

    seen = seen[structure.triangulated[seen.points]]
    if len(seen.points) < MIN_INLIERS:
        return None
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = MAX_POSE_ERROR_PX
    options.ransac.random_seed = SEED
    options.ransac.min_inlier_ratio = MIN_INLIER_SHARE
    options.ransac.max_num_trials = 1000
    positions, camera = seen.positions + COLMAP_FIRST_PIXEL_PX, pinhole_camera(structure.K)
    answer = pycolmap.estimate_and_refine_absolute_pose(
        positions, structure.points[seen.points], camera, options
    )
    if answer is None:
        return None
    pose = np.asarray(answer["cam_from_world"].matrix(), np.float64)
    errors = reprojection_errors(replace(structure, poses={frame: pose}), seen)
    num_inliers = np.count_nonzero(errors <= MAX_POSE_ERROR_PX)
    return pose if num_inliers >= max(MIN_INLIERS, MIN_INLIER_SHARE * len(errors)) else None


def adjust_bundle(
    structure: Structure, seen: Observations, free: Collection[int] | None = None, *, focal: bool = True
) -> Structure:
    """Minimise reprojection errors over points, poses of `free` frames (default: all), and focal length."""
    import pycolmap

    seen = seen[structure.triangulated[seen.points]]
    seen = seen[np.bincount(seen.points, minlength=1)[seen.points] >= 2]
    if not len(seen.points):
        return structure
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pinhole_camera(structure.K))
    order = np.argsort(seen.frames, kind="stable")
    keypoint = np.empty(len(order), np.int64)
    numbers, start = np.unique(seen.frames[order], return_index=True)
    frames = numbers.tolist()
    for frame, rows in zip(frames, np.split(order, start[1:]), strict=True):
        keypoint[rows] = np.arange(len(rows))
        keypoints = seen.positions[rows] + COLMAP_FIRST_PIXEL_PX
        image = pycolmap.Image(name=str(frame), keypoints=keypoints, camera_id=1, image_id=frame + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(structure.poses[frame]))
    order = np.argsort(seen.points, kind="stable")
    numbers, start = np.unique(seen.points[order], return_index=True)  # COLMAP counts the points from 1
    images, slots = (seen.frames + 1).tolist(), keypoint.tolist()
    for number, rows in zip(numbers, np.split(order, start[1:]), strict=True):
        elements = [pycolmap.TrackElement(images[k], slots[k]) for k in rows]
        model.add_point3D(structure.points[number], pycolmap.Track(elements))
    config = pycolmap.BundleAdjustmentConfig()
    for frame in frames:
        config.add_image(frame + 1)
        if free is not None and frame not in free:
            config.set_constant_rig_from_world_pose(frame + 1)
    if free is None:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=focal, refine_principal_point=False, refine_extra_params=False
    )
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = LOSS_PX
    options.ceres.solver_options.max_num_iterations = MAX_STEPS
    options.ceres.solver_options.function_tolerance = 1e-6
    options.ceres.solver_options.num_threads = 1
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    K, poses, points = structure.K.copy(), dict(structure.poses), structure.points.copy()
    K[0, 0] = K[1, 1] = model.cameras[1].params[0]
    for frame in frames:
        poses[frame] = np.asarray(model.images[frame + 1].cam_from_world().matrix(), np.float64)
    adjusted = model.points3D
    points[numbers] = [adjusted[index].xyz for index in range(1, len(numbers) + 1)]
    return Structure(K, poses, points)
