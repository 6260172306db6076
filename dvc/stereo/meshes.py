"""Meshes of surfaces, layers and sprites for other programs, as PLY or GLB by trimesh, if installed.

Points are in the world of calibrated cameras, else in the frame of one: x to the right, y down, z forward.
GLB files are turned by half a circle, since that format has y up and z towards the viewer.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc import cli
from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.errors import ConfigError, DvcError
from dvc.files import atomic_output, check_folder
from dvc.geometry.camera_array import LatticePosition
from dvc.layers.canvas import DEPTH_RANGE
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import JUMP, Sprite, SpriteSet
from dvc.stereo.rectification.rectified_space import Rectification

Layer = tuple[Bytes, Singles, Mask]
"""Colour, disparity and mask on a canvas."""
_UPRIGHT = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Shape:
    """Coloured points, and triangles between them."""

    points: Floats  # positions
    colours: Bytes  # red, green and blue
    triangles: Integers  # indices of points, counterclockwise for the camera; none for a point set


def points_of_disparity(disparity: NDArray[np.floating], lowest: float, highest: float) -> Floats:
    """Return points in space without calibration: z is 1/d, up to an unknown stretch."""
    height, width = disparity.shape
    highest = max(highest, lowest + 1e-6)
    shift = max(0.0, (highest - DEPTH_RANGE * lowest) / (DEPTH_RANGE - 1.0))
    depth = (highest + shift) / (np.clip(disparity.astype(np.float64), lowest, highest) + shift)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    right, down = (x - (width - 1) / 2) / width, (y - (height - 1) / 2) / width
    return np.stack([right * depth, down * depth, depth], axis=-1)


def points_in_world(
    disparity: NDArray[np.floating], position: LatticePosition, rectification: Rectification
) -> tuple[Floats, Mask]:
    """Return points in space of calibrated cameras, by the homography of space (2.12)."""
    y, x = np.indices(disparity.shape, dtype=np.float64)
    d = disparity.astype(np.float64)
    rectified = np.stack([x + position.m * d, y + position.n * d, d, np.ones_like(d)], axis=-1)
    from_infinity = d + rectification.disparity_shift
    finite = from_infinity > max(float(from_infinity.max()) / DEPTH_RANGE, 0.0)
    points = rectified[finite] @ rectification.world_from_rectified.T
    world = np.zeros((*d.shape, 3))
    world[finite] = points[:, :3] / points[:, 3:]
    return world, finite


def surface_shape(
    points: Floats,
    image: Bytes,
    disparity: NDArray[np.floating],
    max_step_px: float,
    mask: Mask | None = None,
) -> Shape:
    """Turn the surface of a camera into a mesh that is torn at discontinuities."""
    mask = np.ones(disparity.shape, np.bool_) if mask is None else mask
    number = np.full(disparity.shape, -1, np.int64)
    number[mask] = np.arange(np.count_nonzero(mask))
    first, second = slice(None, -1), slice(1, None)
    corners = (first, first), (first, second), (second, first), (second, second)
    triangles = []
    for triple in ((0, 2, 1), (1, 2, 3)):
        numbers = np.stack([number[corners[k]] for k in triple], axis=-1).reshape(-1, 3)
        steps = np.ptp(np.stack([disparity[corners[k]] for k in triple]), axis=0).ravel()
        triangles.append(numbers[(numbers >= 0).all(axis=1) & (steps <= max_step_px)])
    return Shape(points[mask], image[mask], np.concatenate(triangles))


def scene_shape(scene: LayeredDepthImage | SpriteSet) -> Shape:
    """Return the mesh of all layers or sprites, without points beyond infinity."""
    canvas, shapes, num_points = scene.canvas, list[Shape](), 0
    surfaces: Iterable[Layer]
    if isinstance(scene, LayeredDepthImage):
        surfaces = zip(scene.colour, scene.disparity, scene.occupied, strict=True)
    else:
        surfaces = (_on_canvas(sprite, canvas.shape) for sprite in scene.sprites)
    for colour, disparity, mask in surfaces:
        finite = mask & np.isfinite(canvas.depth_scale.depth(disparity))
        with np.errstate(divide="ignore", invalid="ignore"):
            points = canvas.points(disparity)
        shape = surface_shape(points, colour, disparity, JUMP * canvas.resolution, finite)
        shapes.append(replace(shape, triangles=shape.triangles + num_points))
        num_points += len(shape.points)
    parts = [[getattr(shape, name) for shape in shapes] for name in ("points", "colours", "triangles")]
    return Shape(*map(np.concatenate, parts))


def _on_canvas(sprite: Sprite, shape: tuple[int, int]) -> Layer:
    colour, disparity = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
    mask, window = np.zeros(shape, np.bool_), sprite.slices
    colour[window], disparity[window], mask[window] = sprite.colour, sprite.disparity, sprite.mask
    return colour, disparity, mask


def write_shape(path: Path, shape: Shape) -> None:
    """Write points or a mesh."""
    if not len(shape.points):
        raise DvcError(f"cannot write {path}: the surface has no points")
    trimesh = trimesh_module()
    kind = path.suffix.lower()[1:]
    points = shape.points * _UPRIGHT if kind == "glb" else shape.points
    if len(shape.triangles):
        opaque = np.column_stack([shape.colours, np.full(len(shape.colours), 255, np.uint8)])
        mesh = trimesh.Trimesh(points, shape.triangles, vertex_colors=opaque, process=False)
    else:
        mesh = trimesh.PointCloud(points, shape.colours)
    content = mesh.export(file_type=kind)
    with atomic_output(path) as temporary:
        temporary.write_bytes(content)


def trimesh_module() -> Any:
    """Return trimesh; refuse to continue without it."""
    try:
        import trimesh
    except ImportError as err:
        raise ConfigError("meshes need trimesh: pip install 'dvc3d[mesh]'") from err
    return trimesh


def check_outputs(arguments: argparse.Namespace, inputs: Sequence[str | Path]) -> list[Path]:
    """Refuse folders and files that cannot be written, before any work is done; return the meshes."""
    check_folder(arguments.out)
    meshes = [(Path(name), f".{kind}") for kind in ("ply", "glb") if (name := getattr(arguments, kind))]
    for path, ending in meshes:
        if path.suffix.lower() != ending:
            raise ConfigError(f"expected a name that ends in {ending}, got {path}")
    if meshes:
        trimesh_module()
    paths = [path for path, _ in meshes]
    named = [] if arguments.json in (None, "-") else [arguments.json]
    cli.check_outputs(cli.with_contents(inputs), [*paths, *named])
    return paths
