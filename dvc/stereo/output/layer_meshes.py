"""Meshes of layers and sprites, torn at discontinuities."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from dvc.layers.canvas import Canvas
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import JUMP, SpriteSet
from dvc.stereo.output.export import Shape, surface_shape

Surface = tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]


def layers_shape(image: LayeredDepthImage) -> Shape:
    """Return the mesh of all layers."""
    return _shape(image.canvas, zip(image.colour, image.disparity, image.occupied, strict=True))


def sprites_shape(sprites: SpriteSet) -> Shape:
    """Return the mesh of all sprites."""
    return _shape(sprites.canvas, _on_canvas(sprites))


def _on_canvas(sprites: SpriteSet) -> Iterable[Surface]:
    shape = sprites.canvas.shape
    for sprite in sprites.sprites:
        colour, disparity = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
        mask = np.zeros(shape, np.bool_)
        place = sprite.slices
        colour[place], disparity[place], mask[place] = sprite.colour, sprite.disparity, sprite.mask
        yield colour, disparity, mask


def _shape(canvas: Canvas, surfaces: Iterable[Surface]) -> Shape:
    """The mesh of some surfaces, without what is beyond infinity."""
    shapes, num_points = [], 0
    for colour, disparity, mask in surfaces:
        kept = mask & np.isfinite(canvas.depth_scale.depth(disparity))
        with np.errstate(divide="ignore", invalid="ignore"):
            points = canvas.points(disparity)
        shape = surface_shape(points, colour, disparity, JUMP * canvas.resolution, kept)
        shapes.append(Shape(shape.points, shape.colours, shape.triangles + num_points))
        num_points += len(shape.points)
    parts = [[getattr(shape, name) for shape in shapes] for name in ("points", "colours", "triangles")]
    return Shape(*(np.concatenate(part) for part in parts))
