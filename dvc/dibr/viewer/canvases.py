"""Layers and sprites as scenes to look at: pieces of a canvas, which is larger than the view it is about."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, layers_of
from dvc.dibr.layered.bounds import bounds_of_pieces
from dvc.dibr.viewer_scene import Floats, Mask, Piece, Scene, Source, piece_of
from dvc.geometry.camera_array import LatticePosition
from dvc.layers.sprites import Sprite


def scene_of_pieces(scene: Pieces) -> Scene:
    """Return the scene of layers or sprites, moved so that the reference view begins at (0, 0)."""
    canvas, frame = scene.canvas, scene.canvas.frame
    if scene.kind is Kind.LAYERS:
        image = layers_of(scene)
        planes = list(zip(image.colour, image.disparity, image.occupied, strict=True))
    else:
        planes = [plane[:3] for plane in _planes(scene.pieces, canvas.shape)]
    placed = [
        piece._replace(left=piece.left - frame.left, top=piece.top - frame.top)
        for piece in (_cut(piece_of(*plane)) for plane in planes)
        if piece.mask.any()
    ]
    source = Source(LatticePosition(0.0, 0.0), tuple(placed))
    shape = frame.height, frame.width
    return Scene(shape, (source,), canvas.resolution, (source.viewpoint,), bounds_of_pieces(scene))


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


def _planes(sprites: Sequence[Sprite], shape: tuple[int, int]) -> list[_Plane]:
    """Sprites on few planes."""
    planes: list[_Plane] = []
    for sprite in sorted(sprites, key=lambda each: -each.num_values):
        inside = sprite.slices
        plane = next((each for each in planes if not (each.taken[inside] & sprite.mask).any()), None)
        if plane is None:
            plane = _Plane.empty(shape)
            planes.append(plane)
        plane.colour[inside][sprite.mask] = sprite.colour[sprite.mask]
        plane.disparity[inside][sprite.mask] = sprite.disparity[sprite.mask]
        plane.mask[inside] |= sprite.mask
        around = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in inside)
        plane.taken[around] |= cv2.dilate(plane.mask[around].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return planes


def _cut(piece: Piece) -> Piece:
    """Leave out what is empty around a piece."""
    left, top, width, height = cv2.boundingRect(piece.mask.astype(np.uint8))
    inside = slice(top, top + height), slice(left, left + width)
    return Piece(piece.picture[inside], piece.disparity[inside], piece.mask[inside], left, top)
