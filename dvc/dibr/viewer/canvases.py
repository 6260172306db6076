"""Layers and sprites as scenes to look at: pieces of a canvas, which is larger than the view it is about."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.dibr.viewer.scene import BEYOND, Bounds, Floats, Mask, Piece, Scene, Source, bounds_of_one, piece_of
from dvc.multiview.camera_array import LatticePosition
from dvc.stereo.layers.canvas import Canvas
from dvc.stereo.layers.layered_depth_image import LayeredDepthImage
from dvc.stereo.layers.sprites import SpriteSet

STRAYS = 0.02
"""Share of points beyond the frame of a canvas that may be errors."""


def scene_of_layers(image: LayeredDepthImage) -> Scene:
    """Return the scene of a layered depth image."""
    pieces = [
        piece_of(colour, disparity, mask)
        for colour, disparity, mask in zip(image.colour, image.disparity, image.occupied, strict=True)
    ]
    return _scene_of_canvas(image.canvas, pieces)


def scene_of_sprites(sprites: SpriteSet) -> Scene:
    """Return the scene of sprites with depth."""
    planes: list[_Plane] = []
    for sprite in sorted(sprites.sprites, key=lambda each: -each.num_values):
        height, width = sprite.mask.shape
        inside = slice(sprite.top, sprite.top + height), slice(sprite.left, sprite.left + width)
        plane = next((each for each in planes if not (each.taken[inside] & sprite.mask).any()), None)
        if plane is None:
            plane = _Plane.empty(sprites.canvas.shape)
            planes.append(plane)
        plane.colour[inside][sprite.mask] = sprite.colour[sprite.mask]
        plane.disparity[inside][sprite.mask] = sprite.disparity[sprite.mask]
        plane.mask[inside] |= sprite.mask
        rows = slice(max(sprite.top - 1, 0), sprite.top + height + 1)
        columns = slice(max(sprite.left - 1, 0), sprite.left + width + 1)
        around = cv2.dilate(plane.mask[rows, columns].astype(np.uint8), np.ones((3, 3), np.uint8))
        plane.taken[rows, columns] |= around > 0
    return _scene_of_canvas(sprites.canvas, [piece_of(*plane[:3]) for plane in planes])


class _Plane(NamedTuple):
    """Sprites that do not touch each other, and the pixels that no further one may have."""

    colour: NDArray[np.uint8]
    disparity: Floats
    mask: Mask
    taken: Mask

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Self:
        """Return one without sprites."""
        nowhere = np.zeros(shape, np.bool_)
        return cls(np.zeros((*shape, 3), np.uint8), np.zeros(shape), nowhere, nowhere.copy())


def _scene_of_canvas(canvas: Canvas, pieces: Sequence[Piece]) -> Scene:
    """Pieces of a canvas, moved so that the reference view begins at (0, 0)."""
    frame = canvas.frame
    placed = [
        piece._replace(left=piece.left - frame.left, top=piece.top - frame.top) for piece in map(_cut, pieces)
    ]
    source = Source(LatticePosition(0.0, 0.0), tuple(piece for piece in placed if piece.mask.any()))
    shape = frame.height, frame.width
    scene = Scene(shape, (source,), canvas.resolution, (source.viewpoint,), Bounds(0.0, 0.0, 0.0, 0.0))
    bounds = _bounds_of_canvas(scene, canvas)
    return Scene(shape, scene.sources, scene.step, scene.viewpoints, bounds)


def _cut(piece: Piece) -> Piece:
    """Leave out what is empty around a piece."""
    left, top, width, height = cv2.boundingRect(piece.mask.astype(np.uint8))
    inside = slice(top, top + height), slice(left, left + width)
    return Piece(piece.picture[inside], piece.disparity[inside], piece.mask[inside], left, top)


def _bounds_of_canvas(scene: Scene, canvas: Canvas) -> Bounds:
    """A bit beyond the cameras that have seen what lies beyond the frame; around one view if nothing does."""
    ends = []
    for axis, size in ((1, scene.shape[1]), (0, scene.shape[0])):
        needed = [np.zeros(1)]
        for piece in scene.sources[0].pieces:
            position = np.nonzero(piece.mask)[axis] + (piece.top, piece.left)[axis]
            beyond = position - np.clip(position, 0, size - 1)
            disparity = piece.disparity[piece.mask]
            counts = (beyond != 0) & (np.abs(disparity) >= canvas.labels.step)
            needed.append(beyond[counts] / disparity[counts])
        values = np.concatenate(needed)
        ends += [
            min(float(np.quantile(values, STRAYS)), 0.0),
            max(float(np.quantile(values, 1.0 - STRAYS)), 0.0),
        ]
    if max(map(abs, ends)) == 0.0:
        return bounds_of_one(scene)
    beyond_all = BEYOND * max(ends[1] - ends[0], ends[3] - ends[2])
    left, right, top, bottom = ends
    return Bounds(left - beyond_all, right + beyond_all, top - beyond_all, bottom + beyond_all)
