"""Layers and sprites as pieces: pictures with disparities and masks, each somewhere in one canvas."""

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import cv2
import numpy as np

from dvc.errors import ConfigError
from dvc.layers import layer_folders
from dvc.layers.canvas import Canvas
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import Sprite, SpriteSet


class Kind(IntEnum):
    """What pieces are."""

    LAYERS = 0
    SPRITES = 1


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of a scene."""

    canvas: Canvas  # where they are
    kind: Kind  # layers, from near to far; or sprites, in any order
    pieces: tuple[Sprite, ...]  # each within its own frame; of an empty layer, without rows and columns

    @property
    def num_values(self) -> int:
        """Number of pixels of all pieces."""
        return sum(piece.num_values for piece in self.pieces)


def read_pieces(folder: str | Path) -> Pieces:
    """Read a folder of layers or sprites."""
    if (Path(folder) / layer_folders.LAYERS_INDEX).is_file():
        return pieces_of_layers(layer_folders.read_layers(folder))
    if (Path(folder) / layer_folders.SPRITES_INDEX).is_file():
        return pieces_of_sprites(layer_folders.read_sprites(folder))
    raise ConfigError(
        f"{folder}: a folder without {layer_folders.LAYERS_INDEX} or {layer_folders.SPRITES_INDEX}"
    )


def write_pieces(folder: Path, pieces: Pieces) -> None:
    """Write pieces as the folder that they came from; inverse of `read_pieces`."""
    if pieces.kind is Kind.LAYERS:
        layer_folders.write_layers(folder, layers_of(pieces))
    else:
        layer_folders.write_sprites(folder, sprites_of(pieces))


def pieces_of_layers(image: LayeredDepthImage) -> Pieces:
    """Return the layers of an image, each within the rectangle that it takes."""
    pieces = []
    for colour, disparity, mask in zip(image.colour, image.disparity, image.occupied, strict=True):
        left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
        inside = slice(top, top + height), slice(left, left + width)
        pieces.append(Sprite(left, top, mask[inside], colour[inside], disparity[inside]))
    return Pieces(image.canvas, Kind.LAYERS, tuple(pieces))


def pieces_of_sprites(sprites: SpriteSet) -> Pieces:
    """Return sprites as pieces."""
    return Pieces(sprites.canvas, Kind.SPRITES, sprites.sprites)


def layers_of(pieces: Pieces) -> LayeredDepthImage:
    """Return layers as an image of which each lies behind the one before."""
    shape = (len(pieces.pieces), *pieces.canvas.shape)
    colour, votes = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint8)
    disparity = np.zeros(shape, np.float32)
    for layer, piece in enumerate(pieces.pieces):
        mask, values = piece.mask, piece.disparity
        index = (layer, *piece.slices)
        if layer:
            before = (layer - 1, *piece.slices)
            mask = mask & (votes[before] > 0)
            values = np.minimum(values, np.nextafter(disparity[before], np.float32(-np.inf)))
        votes[index] = mask
        disparity[index] = np.where(mask, values, np.float32(0.0))
        colour[index] = piece.colour * mask[..., None]
    return LayeredDepthImage(pieces.canvas, colour, disparity, votes)


def sprites_of(pieces: Pieces) -> SpriteSet:
    """Return pieces as sprites."""
    return SpriteSet(pieces.canvas, pieces.pieces)
