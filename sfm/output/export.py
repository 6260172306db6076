"""Writes a model for other programs: PLY, COLMAP's text format, JSON."""

import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfm.model import Model, Reconstruction
from sfm.output.metric_upgrade import MetricModel, metric_upgrade

Floats = NDArray[np.float64]

_PLY_HEADER = """\
ply
format binary_little_endian 1.0
comment structure from motion between two key frames; unit of length: the distance of the cameras
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


def point_colours(luma: NDArray[np.uint8], points: Floats) -> NDArray[np.uint8]:
    """Look up the grey of each point in the first key frame."""
    height, width = luma.shape
    columns = np.clip(np.rint(points[:, 0]).astype(np.int64), 0, width - 1)
    rows = np.clip(np.rint(points[:, 1]).astype(np.int64), 0, height - 1)
    colours: NDArray[np.uint8] = np.repeat(luma[rows, columns][:, None], 3, axis=1)
    return colours


def write_ply(path: str | Path, model: Model, colours: NDArray[np.uint8]) -> None:
    """Write the points as a binary PLY file, in the nearest Euclidean frame."""
    points = metric_upgrade(model).points.astype("<f4")
    rows = (struct.pack("<3f3B", *point, *colour) for point, colour in zip(points, colours, strict=True))
    Path(path).write_bytes(_PLY_HEADER.format(count=len(points)).encode("ascii") + b"".join(rows))


def write_colmap(
    folder: str | Path, model: Model, names: tuple[str, str], colours: NDArray[np.uint8]
) -> None:
    """Write ``cameras.txt``, ``images.txt`` and ``points3D.txt`` in COLMAP's text format."""
    metric, frame, matches = metric_upgrade(model), model.pixel_frame, model.correspondences
    target = Path(folder)
    width, height = frame.width_px, frame.height_px
    focal = f"{metric.focal_length_px:.10g}"
    _write_lines(
        target / "cameras.txt",
        ["# Camera list with one line of data per camera: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"],
        [f"1 SIMPLE_PINHOLE {width} {height} {focal} {width / 2:g} {height / 2:g}"],
    )
    poses = [np.eye(3, 4), metric.second_from_first]
    images = []
    for number, (name, pose, points) in enumerate(
        zip(names, poses, (matches.first, matches.second), strict=True), start=1
    ):
        numbers = [*_quaternion(pose[:, :3]), *pose[:, 3]]
        images.append(f"{number} {' '.join(f'{value:.12g}' for value in numbers)} 1 {name}")
        images.append(" ".join(f"{x + 0.5:.6f} {y + 0.5:.6f} {i}" for i, (x, y) in enumerate(points, 1)))
    _write_lines(
        target / "images.txt",
        [
            "# Image list with two lines of data per image:",
            "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
            "#   POINTS2D[] as (X, Y, POINT3D_ID)",
        ],
        images,
    )
    _write_lines(
        target / "points3D.txt",
        ["# 3D point list: POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"],
        (
            f"{i + 1} {x:.10g} {y:.10g} {z:.10g} {r} {g} {b} {metric.error_px:.4f} 1 {i} 2 {i}"
            for i, ((x, y, z), (r, g, b)) in enumerate(zip(metric.points, colours, strict=True))
        ),
    )


def _write_lines(path: Path, comments: list[str], lines: Iterable[str]) -> None:
    path.write_text("\n".join([*comments, *lines]) + "\n")


def _quaternion(rotation: Floats) -> Floats:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True)
    return np.array([w, x, y, z])


def to_dict(reconstruction: Reconstruction) -> dict[str, Any]:
    """Describe a reconstruction as JSON-safe values."""
    counts = {name: len(matches) for name, matches in reconstruction.stages.items()}
    values: dict[str, Any] = {
        "success": reconstruction.success,
        "reason": reconstruction.reason,
        "motion": reconstruction.motion,
        "num_correspondences": counts,
        "model": None,
    }
    if reconstruction.model is not None:
        values["model"] = _model_to_dict(reconstruction.model)
    return values


def _model_to_dict(model: Model) -> dict[str, Any]:
    metric: MetricModel = metric_upgrade(model)
    matches = model.correspondences
    return {
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


def write_json(path: str | Path, reconstruction: Reconstruction) -> None:
    """Write what `to_dict` returns."""
    Path(path).write_text(json.dumps(to_dict(reconstruction), indent=1) + "\n")
