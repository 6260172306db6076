"""Writes a model for other programs: PLY, COLMAP's text format, JSON."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfm.model import Model, Reconstruction
from sfm.output.colmap_text import ColmapCloud, ColmapImage, write_colmap_text
from sfm.output.metric_upgrade import MetricModel, metric_upgrade
from sfm.output.point_cloud import write_ply

PLY_COMMENT = "structure from motion between two key frames; unit of length: the distance of the cameras"


def point_colours(luma: NDArray[np.uint8], points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Look up the grey of each point in the first key frame."""
    height, width = luma.shape
    columns = np.clip(np.rint(points[:, 0]).astype(np.int64), 0, width - 1)
    rows = np.clip(np.rint(points[:, 1]).astype(np.int64), 0, height - 1)
    colours: NDArray[np.uint8] = np.repeat(luma[rows, columns][:, None], 3, axis=1)
    return colours


def write_points(path: str | Path, model: Model, colours: NDArray[np.uint8]) -> None:
    """Write the points as a binary PLY file, in the nearest Euclidean frame."""
    write_ply(path, metric_upgrade(model).points, colours, PLY_COMMENT)


def write_colmap(
    folder: str | Path, model: Model, names: tuple[str, str], colours: NDArray[np.uint8]
) -> None:
    """Write ``cameras.txt``, ``images.txt`` and ``points3D.txt`` in COLMAP's text format."""
    metric, frame, matches = metric_upgrade(model), model.pixel_frame, model.correspondences
    size = frame.width_px, frame.height_px
    intrinsics = np.diag([metric.focal_length_px, metric.focal_length_px, 1.0])
    intrinsics[:2, 2] = 0.5 * (np.array(size) - 1.0)
    images = [
        ColmapImage(1, names[0], np.eye(3, 4), matches.first),
        ColmapImage(2, names[1], metric.second_from_first, matches.second),
    ]
    write_colmap_text(
        Path(folder), size, intrinsics, images, ColmapCloud(metric.points, colours, metric.error_px)
    )


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
