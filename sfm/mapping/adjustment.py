"""Bundle adjustment of many frames by COLMAP, and the pose of one frame from known points.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.mapping.structure import Observations, Structure, reprojection

Floats = NDArray[np.float64]

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
