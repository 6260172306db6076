"""Files of maps and of scenes of two pictures: COLMAP's models, clouds, camera paths, depth maps, figures."""

import json
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.estimation.epipolar import epipolar_lines
from sfm.scene_model import Correspondences, Model, Reconstruction

MAX_LEVEL = 2**16 - 1
PLY_HEADER = """\
ply
format binary_little_endian 1.0
comment {comment}
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""
PLY_COMMENT = "structure from motion between two key frames; unit of length: the distance of the cameras"
USUAL_FOCAL_LENGTH = 1.2
"""Focal length of most cameras, in units of the longer side of the image."""
PRIOR_WEIGHT = 0.002
"""Weight of the usual focal length and of the given plane at infinity: relevant only if undetermined."""
ZOOM = 3
_SHIFT = 4  # fractional bits of drawn positions
_RED, _MAGENTA, _GREEN = (40, 40, 235), (220, 60, 220), (70, 200, 40)  # blue, green, red
_HALF_LINE_PX = 9.0
_TITLE_PX = 36


def colmap_model(
    size: tuple[int, int],
    intrinsics: Floats,
    poses: Mapping[str, Floats],
    cloud: tuple[Floats, Bytes],
    tracks: Sequence[Floats] = (),
) -> Any:
    """Return COLMAP's model of one camera, pictures with poses by file name, and coloured points.

    `tracks` are the positions of all points in each picture; without them points have no track. COLMAP puts
    the centre of the first pixel at (0.5, 0.5); this function converts.
    """
    import pycolmap

    if intrinsics[0, 1] != 0.0:
        raise ValueError(f"`intrinsics` must have no skew, got {intrinsics[0, 1]}")
    (fx, fy), (cx, cy) = np.diag(intrinsics)[:2], intrinsics[:2, 2] + COLMAP_FIRST_PIXEL_PX
    kind, focal = ("SIMPLE_PINHOLE", [fx]) if fx == fy else ("PINHOLE", [fx, fy])
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model=kind, width=size[0], height=size[1], params=[*focal, cx, cy], camera_id=1)
    )
    for number, (name, pose) in enumerate(poses.items()):
        keypoints = tracks[number] + COLMAP_FIRST_PIXEL_PX if tracks else np.empty((0, 2))
        image = pycolmap.Image(name=name, keypoints=keypoints, camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    for index, (position, colour) in enumerate(zip(*cloud, strict=True)):
        elements = [pycolmap.TrackElement(number + 1, index) for number in range(len(tracks))]
        model.add_point3D(position, pycolmap.Track(elements), colour)
    model.update_point_3d_errors()
    return model


def write_ply(path: Path, points: Floats, colours: Bytes, comment: str) -> None:
    """Write points, shape (N, 3), in single precision, with red, green and blue, as a binary PLY file."""
    vertices = np.empty(len(points), [("position", "<f4", 3), ("colour", "u1", 3)])
    vertices["position"], vertices["colour"] = points, colours
    path.write_bytes(PLY_HEADER.format(comment=comment, count=len(points)).encode() + vertices.tobytes())


def write_trajectory(path: Path, poses: Mapping[int, Floats], fps: Fraction | float | None) -> None:
    """Write poses as the TUM RGB-D benchmark does, camera to world; times follow from frame indices."""
    from scipy.spatial.transform import Rotation

    unit = "frame index" if fps is None else f"seconds, frame index / {fps}"
    lines = ["# timestamp tx ty tz qx qy qz qw", f"# camera to world; timestamp: {unit}"]
    for number in sorted(poses):
        turn, shift = poses[number][:, :3].T, poses[number][:, 3]
        quaternion = Rotation.from_matrix(turn).as_quat(canonical=True)
        time = f"{number}" if fps is None else f"{float(number / Fraction(fps)):.6f}"
        lines.append(" ".join([time, *(f"{value:.9g}" for value in (*(-turn @ shift), *quaternion))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def is_known(depth: Singles) -> Mask:
    """Return a mask of the pixels with a depth."""
    return np.isfinite(depth) & (depth > 0.0)


def depth_step(depths: Mapping[int, Singles]) -> float:
    """Return the depth of one level, so that the largest depth of all has the largest level."""
    largest = max((float(depth[is_known(depth)].max(initial=0.0)) for depth in depths.values()), default=0.0)
    return largest / MAX_LEVEL or 1.0


def write_depth_maps(folder: Path, depths: Mapping[int, Singles], step: float) -> None:
    """Write ``000012.png`` for frame 12, and so on, with levels of 16 bits from 1; 0 is unknown."""
    for number, depth in depths.items():
        known, levels = is_known(depth), np.zeros(depth.shape, np.uint16)
        coarse = np.rint(depth[known].astype(np.float64) / step)
        levels[known] = np.clip(coarse, 1, MAX_LEVEL).astype(np.uint16)
        _, coded = cv2.imencode(".png", levels)
        (folder / f"{number:06d}.png").write_bytes(coded.tobytes())


class MetricModel(NamedTuple):
    """A Euclidean reconstruction; its unit of length is the distance of the cameras."""

    focal_length_px: float  # of both key frames; the principal point is the centre
    second_from_first: Floats  # [R | t] from the first to the second camera
    points: Floats  # 3D points in the frame of the first camera
    error_px: float  # root mean square reprojection error in the second key frame


def metric_upgrade(model: Model) -> MetricModel:
    """Find the plane at infinity and the focal length under which the second camera moved most rigidly."""
    from scipy.optimize import least_squares

    rotation, translation = model.second_camera[:, :3], model.second_camera[:, 3]

    def _residuals(parameters: Floats) -> Floats:
        matrix, focal = _rigid_part(rotation, translation, parameters)
        prior = [np.log(focal / USUAL_FOCAL_LENGTH), *parameters[1:]]
        return np.concatenate([(matrix - _nearest_rotation(matrix)).ravel(), PRIOR_WEIGHT * np.array(prior)])

    start = np.array([np.log(USUAL_FOCAL_LENGTH), 0.0, 0.0, 0.0])
    best = least_squares(_residuals, start, method="lm", max_nfev=2000).x
    matrix, focal = _rigid_part(rotation, translation, best)
    plane, turn = best[1:], _nearest_rotation(matrix)
    scale = float(np.cbrt(abs(np.linalg.det(rotation - np.outer(translation, plane)))))
    shift = translation / (np.array([focal, focal, 1.0]) * max(scale, 1e-12))
    rays = model.points[:, :3] / model.depths[:, None]
    depths = model.depths / (1.0 + model.points[:, :3] @ plane)
    points = depths[:, None] * rays / np.array([focal, focal, 1.0])
    length = max(float(np.linalg.norm(shift)), 1e-12)
    points, shift = points / length, shift / length
    seen = points @ turn.T + shift
    with np.errstate(divide="ignore", invalid="ignore"):
        second = model.pixel_frame.to_pixels(focal * seen[:, :2] / seen[:, 2:])
    error = np.linalg.norm(second - model.correspondences.second, axis=1)
    error = error[np.isfinite(error)]
    error_px = float(np.sqrt(np.mean(error**2))) if error.size else 0.0
    return MetricModel(focal * model.pixel_frame.scale_px, np.column_stack([turn, shift]), points, error_px)


def _rigid_part(rotation: Floats, translation: Floats, parameters: Floats) -> tuple[Floats, float]:
    """Return ``K^-1 (R - t a') K`` at unit determinant, and f."""
    focal = float(np.exp(np.clip(parameters[0], -3.0, 3.0)))
    k = np.array([focal, focal, 1.0])
    matrix = (rotation - np.outer(translation, parameters[1:])) * k[None, :] / k[:, None]
    determinant = abs(float(np.linalg.det(matrix)))
    return matrix / np.cbrt(max(determinant, 1e-12)), focal


def _nearest_rotation(matrix: Floats) -> Floats:
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def point_colours(luma: Bytes, points: Floats) -> Bytes:
    """Return the grey of each point in the first key frame, as red, green and blue."""
    last = np.array(luma.shape[::-1]) - 1
    columns, rows = np.clip(np.rint(points), 0, last).astype(np.int64).T
    return np.repeat(luma[rows, columns][:, None], 3, axis=1)


def write_model(folder: Path, model: Model, colours: Bytes) -> None:
    """Write the nearest Euclidean model: its points as a PLY file, and all in COLMAP's text format."""
    metric, matches = metric_upgrade(model), model.correspondences
    size = model.pixel_frame.width_px, model.pixel_frame.height_px
    intrinsics = np.diag([metric.focal_length_px, metric.focal_length_px, 1.0])
    intrinsics[:2, 2] = 0.5 * (np.array(size) - 1.0)
    poses = {"first.png": np.eye(3, 4), "second.png": metric.second_from_first}
    tracks = matches.first, matches.second
    colmap_model(size, intrinsics, poses, (metric.points, colours), tracks).write_text(folder)
    write_ply(folder / "points.ply", metric.points, colours, PLY_COMMENT)


def to_dict(reconstruction: Reconstruction) -> dict[str, Any]:
    """Describe a reconstruction as JSON-safe values."""
    model = reconstruction.model
    document: dict[str, Any] = {
        "success": reconstruction.success,
        "reason": reconstruction.reason,
        "motion": reconstruction.motion,
        "num_correspondences": {name: len(matches) for name, matches in reconstruction.stages.items()},
        "model": None,
    }
    if model is None:
        return document
    metric, matches = metric_upgrade(model), model.correspondences
    document["model"] = {
        "size": [model.pixel_frame.width_px, model.pixel_frame.height_px],
        "fundamental": model.fundamental.tolist(),
        "second_camera": model.second_camera.tolist(),
        "pixel_from_normalized": model.pixel_frame.pixel_from_normalized.tolist(),
        "euclidean": {
            "focal_length_px": metric.focal_length_px,
            "second_from_first": metric.second_from_first.tolist(),
            "error_px": metric.error_px,
        },
        "first_px": np.round(matches.first, 4).tolist(),
        "second_px": np.round(matches.second, 4).tolist(),
        "depths": np.round(model.depths, 6).tolist(),
    }
    return document


def write_json(path: Path, values: object) -> None:
    """Write values as JSON."""
    path.write_text(json.dumps(values, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def draw_correspondences(
    luma: Bytes, matches: Correspondences, fundamental: Floats | None, title: str
) -> Bytes:
    """Draw points, motion and epipolar lines over the second key frame, as in figures 5.3 and 5.10."""
    height, width = luma.shape
    grey = cv2.resize(luma, (ZOOM * width, ZOOM * height), interpolation=cv2.INTER_CUBIC)
    faded = (96 + grey.astype(np.int64) * 150 // 255).astype(np.uint8)
    canvas = np.repeat(faded[:, :, None], 3, axis=2)
    if fundamental is not None and len(matches):
        lines = epipolar_lines(fundamental, matches.first)
        along = _HALF_LINE_PX * np.column_stack([-lines[:, 1], lines[:, 0]])
        _draw_lines(canvas, matches.second - along, matches.second + along, _GREEN)
    _draw_lines(canvas, matches.first, matches.second, _MAGENTA)
    radius = 2 if len(matches) < 2000 else 1
    for x, y in _fixed_point(matches.second):
        cv2.circle(canvas, (x, y), radius << _SHIFT, _RED, -1, cv2.LINE_AA, _SHIFT)
    banner = np.full((_TITLE_PX, canvas.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(banner, title, (8, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (30, 30, 30), 1, cv2.LINE_AA)
    return np.vstack([banner, canvas])


def _fixed_point(points: Floats) -> Integers:
    """Convert image points to positions on the enlarged canvas, in 1/16 pixels."""
    bounded = np.clip(np.nan_to_num(points), -1e4, 1e4)
    return np.rint((bounded * ZOOM + 0.5 * (ZOOM - 1)) * (1 << _SHIFT)).astype(np.int64)


def _draw_lines(canvas: Bytes, starts: Floats, ends: Floats, colour: tuple[int, int, int]) -> None:
    for (x0, y0), (x1, y1) in zip(_fixed_point(starts), _fixed_point(ends), strict=True):
        cv2.line(canvas, (x0, y0), (x1, y1), colour, 1, cv2.LINE_AA, _SHIFT)


def side_by_side(pictures: list[Bytes]) -> Bytes:
    """Put pictures of one height next to each other with a white gap."""
    gap = np.full((pictures[0].shape[0], 12, 3), 255, dtype=np.uint8)
    return np.hstack([part for picture in pictures for part in (gap, picture)][1:])
