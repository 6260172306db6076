"""Point sets and meshes for other programs, as PLY or GLB, by trimesh where it is installed.

Points are in the world of calibrated cameras, else in the frame of one: x to the right, y down, z forward.
GLB files are turned by half a circle, since that format has y up and z towards the viewer.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError, DvcError
from dvc.files import atomic_output
from dvc.geometry.camera_array import LatticePosition
from dvc.layers.canvas import DEPTH_RANGE
from dvc.stereo.rectification.rectified_space import Rectification

Floats = NDArray[np.float64]
_UPRIGHT = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Shape:
    """Coloured points, and triangles between them."""

    points: Floats  # positions
    colours: NDArray[np.uint8]  # red, green and blue
    triangles: NDArray[np.int64]  # numbers of points, counterclockwise for the camera; none for a point set


def points_of_disparity(disparity: NDArray[np.floating], lowest: float, highest: float) -> Floats:
    """Return points in space where nothing is calibrated: z is 1/d, up to an unknown stretch."""
    height, width = disparity.shape
    highest = max(highest, lowest + 1e-6)
    shift = max(0.0, (highest - DEPTH_RANGE * lowest) / (DEPTH_RANGE - 1.0))
    depth = (highest + shift) / (np.clip(disparity.astype(np.float64), lowest, highest) + shift)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    right, down = (x - (width - 1) / 2) / width, (y - (height - 1) / 2) / width
    return np.stack([right * depth, down * depth, depth], axis=-1)


def points_in_world(
    disparity: NDArray[np.floating], position: LatticePosition, rectification: Rectification
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return points in space where cameras are calibrated, by the homography of space (2.12)."""
    y, x = np.indices(disparity.shape, dtype=np.float64)
    d = disparity.astype(np.float64)
    rectified = np.stack([x + position.m * d, y + position.n * d, d, np.ones_like(d)], axis=-1)
    from_infinity = d + rectification.disparity_shift
    known = from_infinity > max(float(from_infinity.max()) / DEPTH_RANGE, 0.0)
    points = rectified[known] @ rectification.world_from_rectified.T
    world = np.zeros((*d.shape, 3))
    world[known] = points[:, :3] / points[:, 3:]
    return world, known


def surface_shape(
    points: Floats,
    image: NDArray[np.uint8],
    disparity: NDArray[np.floating],
    max_step_px: float,
    kept: NDArray[np.bool_] | None = None,
) -> Shape:
    """Turn the surface that a camera sees into a mesh that is torn at discontinuities."""
    kept = np.ones(disparity.shape, np.bool_) if kept is None else kept
    number = np.full(disparity.shape, -1, np.int64)
    number[kept] = np.arange(np.count_nonzero(kept))
    first, second = slice(None, -1), slice(1, None)
    corners = (first, first), (first, second), (second, first), (second, second)
    triangles = []
    for triple in ((0, 2, 1), (1, 2, 3)):
        numbers = np.stack([number[corners[k]] for k in triple], axis=-1).reshape(-1, 3)
        steps = np.ptp(np.stack([disparity[corners[k]] for k in triple]), axis=0).ravel()
        triangles.append(numbers[(numbers >= 0).all(axis=1) & (steps <= max_step_px)])
    return Shape(points[kept], image[kept], np.concatenate(triangles))


def write_shape(path: Path, shape: Shape) -> None:
    """Write points or a mesh."""
    if not len(shape.points):
        raise DvcError(f"cannot write {path}: the surface has no points")
    trimesh = _trimesh()
    kind = path.suffix.lower()[1:]
    points = shape.points * _UPRIGHT if kind == "glb" else shape.points
    if len(shape.triangles):
        opaque = np.column_stack([shape.colours, np.full(len(shape.colours), 255, np.uint8)])
        made = trimesh.Trimesh(points, shape.triangles, vertex_colors=opaque, process=False)
    else:
        made = trimesh.PointCloud(points, shape.colours)
    content = made.export(file_type=kind)
    with atomic_output(path) as temporary:
        temporary.write_bytes(content)


def require_trimesh() -> None:
    """Make sure that `write_shape` will work."""
    _trimesh()


def _trimesh() -> Any:
    try:
        import trimesh
    except ImportError as err:
        raise ConfigError("meshes need trimesh: pip install 'dvc3d[mesh]'") from err
    return trimesh
