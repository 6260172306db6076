"""Cameras of several frames, points of the scene, and where frames see them; triangulation of the points."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.mapping.point_tracker import SeenPoints

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

MIN_ANGLE_DEG = 1.5
"""Least angle between the rays to a point; below it the depth is noise."""
MAX_ERROR_PX = 2.0
"""Reprojection error beyond which a point is not where its track is."""
NUM_STEPS = 4
"""Gauss-Newton steps after the linear solution."""
MIN_DEPTH = 1e-9
SEED = 0
LOSS_PX = 0.3
"""Where the robust loss becomes linear: about the error of a good track."""
MAX_STEPS = 50
MIN_INLIERS = 20
"""Points that a pose needs."""
MIN_INLIER_SHARE = 0.4
"""Share of the points that agree, below which a pose is doubtful."""
MAX_POSE_ERROR_PX = 3.0
"""Largest error of a point that agrees with a pose."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Where frames see points, one line for each."""

    frames: Indices  # numbers of frames
    points: Indices  # numbers of points
    positions: Floats  # (x, y) in pixels

    def __getitem__(self, chosen: Mask | Indices) -> "Observations":
        """Return some of the lines."""
        return Observations(self.frames[chosen], self.points[chosen], self.positions[chosen])

    def joined(self, other: "Observations") -> "Observations":
        """Return these lines and others."""
        return Observations(
            np.concatenate([self.frames, other.frames]),
            np.concatenate([self.points, other.points]),
            np.concatenate([self.positions, other.positions]),
        )


@dataclass(eq=False)
class Structure:
    """A part of the scene in the making."""

    K: Floats  # intrinsics of all frames
    poses: dict[int, Floats] = field(default_factory=dict)  # (3, 4) by number of frame
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))  # nan where a point is not known

    @property
    def known(self) -> Mask:
        """Which points are known."""
        known: Mask = np.isfinite(self.points[:, 0])
        return known


def observations(seen: Sequence[SeenPoints], frames: Sequence[int]) -> Observations:
    """Put together what some frames see."""
    parts = [seen[index] for index in frames]
    numbers = np.repeat(np.asarray(frames, np.int64), [len(part.ids) for part in parts])
    ids = np.concatenate([np.empty(0, np.int64), *(part.ids for part in parts)])
    return Observations(numbers, ids, np.concatenate([np.empty((0, 2)), *(part.positions for part in parts)]))


def reprojection(structure: Structure, seen: Observations) -> tuple[Floats, Floats]:
    """Return errors in pixels, inf where unknown, and depths of points in the frames that see them."""
    poses = stacked(structure.poses, seen.frames)
    inside = np.einsum("nij,nj->ni", poses[:, :, :3], structure.points[seen.points]) + poses[:, :, 3]
    depth = inside[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        image = inside @ structure.K.T
        offset = image[:, :2] / image[:, 2:] - seen.positions
        error = np.hypot(offset[:, 0], offset[:, 1])
    return np.where(np.isfinite(error) & (depth > MIN_DEPTH), error, np.inf), depth


def rays_through(K: Floats, positions: Floats) -> Floats:
    """Return the directions (x, y, 1) in the camera of positions in pixels."""
    return np.column_stack([(positions - K[:2, 2]) / K[0, 0], np.ones(len(positions))])


def stacked(poses: dict[int, Floats], frames: Indices) -> Floats:
    """Return the poses (N, 3, 4) of frames that have one."""
    if not len(frames):
        return np.empty((0, 3, 4))
    numbers, inverse = np.unique(frames, return_inverse=True)
    return np.stack([poses[int(number)] for number in numbers])[inverse]


def triangulate(structure: Structure, seen: Observations) -> tuple[Indices, Floats]:
    """Find points from all frames that see them: their numbers and positions, where they are well determined.

    What does not agree with a point is dropped once, and the point found anew.
    """
    numbers, points, errors = _triangulated(structure, seen)
    agreeing = errors <= np.maximum(MAX_ERROR_PX, _medians(seen.points, errors))
    if not agreeing.all():
        seen = seen[agreeing]
        numbers, points, errors = _triangulated(structure, seen)
    _, which, count = np.unique(seen.points, return_inverse=True, return_counts=True)
    worst = np.zeros(len(numbers))
    np.maximum.at(worst, which, errors)
    rays = rays_through(structure.K, seen.positions)
    angles = widest_angles_deg(stacked(structure.poses, seen.frames), rays, which, len(numbers))
    good = (count >= 2) & (worst <= MAX_ERROR_PX) & (angles >= MIN_ANGLE_DEG)
    return numbers[good], points[good]


def _triangulated(structure: Structure, seen: Observations) -> tuple[Indices, Floats, Floats]:
    """Return numbers and positions of points, and the error of every observation."""
    numbers, which = np.unique(seen.points, return_inverse=True)
    poses = stacked(structure.poses, seen.frames)
    rays = rays_through(structure.K, seen.positions)
    points = _linear(poses, rays, which, len(numbers))
    for _ in range(NUM_STEPS):
        points = _step(poses, rays, which, points)
    trial = replace(structure, points=points)
    errors, _ = reprojection(trial, Observations(seen.frames, which.astype(np.int64), seen.positions))
    return numbers, points, errors


def _medians(numbers: Indices, values: Floats) -> Floats:
    """Return for every line the lower median of the lines with the same number."""
    order = np.lexsort((values, numbers))
    _, start, which, count = np.unique(
        numbers[order], return_index=True, return_inverse=True, return_counts=True
    )
    median = np.empty(len(values))
    median[order] = values[order][(start + (count - 1) // 2)[which]]
    return median


def widest_angles_deg(poses: Floats, rays: Floats, which: Indices, count: int) -> Floats:
    """Measure the angle between the rays to each point: the largest to that of the first frame."""
    world = np.einsum("nij,ni->nj", poses[:, :, :3], rays / np.linalg.norm(rays, axis=1, keepdims=True))
    first = np.full(count, len(which), np.int64)
    np.minimum.at(first, which, np.arange(len(which)))
    cosine = np.clip((world * world[first[which]]).sum(axis=1), -1.0, 1.0)
    least = np.ones(count)
    np.minimum.at(least, which, cosine)
    return np.degrees(np.arccos(least))


def _linear(poses: Floats, rays: Floats, which: Indices, count: int) -> Floats:
    """Solve the homogeneous equations of all points."""
    rows = rays[:, :2, None] * poses[:, 2:3] - poses[:, :2]
    normal = np.zeros((count, 4, 4))
    np.add.at(normal, which, np.einsum("nki,nkj->nij", rows, rows))
    found = np.linalg.eigh(normal)[1][:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(found[:, :3] / found[:, 3:])


def _step(poses: Floats, rays: Floats, which: Indices, points: Floats) -> Floats:
    """Make a Gauss-Newton step of all points."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inside = np.einsum("nij,nj->ni", poses[:, :, :3], points[which]) + poses[:, :, 3]
        place = inside[:, :2] / inside[:, 2:]
        jacobian = (poses[:, :2, :3] - place[:, :, None] * poses[:, 2:3, :3]) / inside[:, 2, None, None]
        residual = rays[:, :2] - place
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(normal, which, np.einsum("nki,nkj->nij", jacobian, jacobian))
    np.add.at(right, which, np.einsum("nki,nk->ni", jacobian, residual))
    usable = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    normal[~usable], right[~usable] = np.eye(3), np.nan
    trace = np.einsum("nii->n", normal)
    normal += (1e-9 * trace + 1e-300)[:, None, None] * np.eye(3)
    return np.asarray(points + np.linalg.solve(normal, right[:, :, None])[:, :, 0])


def adjust(
    structure: Structure, seen: Observations, free: Collection[int] | None = None, *, focal: bool = True
) -> Structure:
    """Minimise the reprojection errors of frames and points.

    Frames that are not free keep their pose; all are free where `free` is None. The focal length stays where
    `focal` is false. Without a point that two frames see, all stays as it is.
    """
    import pycolmap

    seen = seen[structure.known[seen.points]]
    seen = seen[np.bincount(seen.points, minlength=1)[seen.points] >= 2]
    if not len(seen.points):
        return structure
    model, numbers = _model(structure, seen)
    config = pycolmap.BundleAdjustmentConfig()
    frames = [int(frame) for frame in np.unique(seen.frames)]
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
    return _structure(structure, model, frames, numbers)


def _camera(structure: Structure) -> Any:
    import pycolmap

    K = structure.K
    parameters = [K[0, 0], K[0, 2] + COLMAP_FIRST_PIXEL_PX, K[1, 2] + COLMAP_FIRST_PIXEL_PX]
    size = round(2 * parameters[1]), round(2 * parameters[2])
    return pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=size[0], height=size[1], params=parameters, camera_id=1
    )


def _model(structure: Structure, seen: Observations) -> tuple[Any, NDArray[np.int64]]:
    """Make COLMAP's model of what is seen; its points are those of these numbers, counted from 1."""
    import pycolmap

    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(_camera(structure))
    order = np.argsort(seen.frames, kind="stable")
    row = np.empty(len(order), np.int64)
    frames, start = np.unique(seen.frames[order], return_index=True)
    for frame, rows in zip(frames, np.split(order, start[1:]), strict=True):
        row[rows] = np.arange(len(rows))
        image = pycolmap.Image(
            name=str(frame),
            keypoints=seen.positions[rows] + COLMAP_FIRST_PIXEL_PX,
            camera_id=1,
            image_id=int(frame) + 1,
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(structure.poses[int(frame)]))
    order = np.argsort(seen.points, kind="stable")
    numbers, start = np.unique(seen.points[order], return_index=True)
    images, places = (seen.frames + 1).tolist(), row.tolist()
    for number, lines in zip(numbers, np.split(order, start[1:]), strict=True):
        elements = [pycolmap.TrackElement(images[line], places[line]) for line in lines]
        model.add_point3D(structure.points[number], pycolmap.Track(elements))
    return model, numbers


def _structure(
    before: Structure, model: Any, frames: Collection[int], numbers: NDArray[np.int64]
) -> Structure:
    K = before.K.copy()
    K[0, 0] = K[1, 1] = model.cameras[1].params[0]
    poses = dict(before.poses)
    for frame in frames:
        poses[frame] = np.asarray(model.images[frame + 1].cam_from_world().matrix(), np.float64)
    points = before.points.copy()
    found = model.points3D
    for position, number in enumerate(numbers, start=1):
        points[number] = found[position].xyz
    return Structure(K, poses, points)


def locate(structure: Structure, frame: int, seen: Observations) -> Floats | None:
    """Find the pose of a frame from the points that it sees; None where they do not agree on one."""
    import pycolmap

    seen = seen[structure.known[seen.points]]
    if len(seen.points) < MIN_INLIERS:
        return None
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = MAX_POSE_ERROR_PX
    options.ransac.random_seed = SEED
    options.ransac.min_inlier_ratio = MIN_INLIER_SHARE
    options.ransac.max_num_trials = 1000
    answer = pycolmap.estimate_and_refine_absolute_pose(
        seen.positions + COLMAP_FIRST_PIXEL_PX, structure.points[seen.points], _camera(structure), options
    )
    if answer is None:
        return None
    pose = np.asarray(answer["cam_from_world"].matrix(), np.float64)
    errors, _ = reprojection(replace(structure, poses={frame: pose}), seen)
    agreeing = np.count_nonzero(errors <= MAX_POSE_ERROR_PX)
    return pose if agreeing >= max(MIN_INLIERS, MIN_INLIER_SHARE * len(errors)) else None
