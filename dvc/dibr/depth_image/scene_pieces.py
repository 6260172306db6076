"""Layers and sprites as pieces: pictures with disparities and masks, each at a position in one canvas.

A view is rendered from them forward, near over far.
"""

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats
from dvc.dibr.view_rendering import picture_of, with_margin
from dvc.errors import ConfigError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import PictureWithDepth, SynthesisedView, drawn_depth, fill_from_background
from dvc.geometry.viewpoints import lattice_warp
from dvc.geometry.warping import EMPTY, inverse_warp, sample, warp_grid
from dvc.images.colour import luma
from dvc.layers import layer_folders
from dvc.layers.canvas import Canvas
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import Sprite, SpriteSet

BEYOND = 0.25
"""Largest distance of a viewpoint beyond the views, relative to the longer side of their lattice."""
ACROSS = 0.1
"""Largest parallax around a single view, relative to the width."""
STRAYS = 0.02
"""Share of points beyond the frame of a canvas that may be errors."""
_MARGIN = 1
"""Pixels around a piece for the outer halves of its pixels: other pieces may begin there."""


class Kind(IntEnum):
    """Kinds of pieces."""

    LAYERS = 0
    SPRITES = 1


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of a scene."""

    canvas: Canvas
    kind: Kind  # layers, from near to far; or sprites, in any order
    pieces: tuple[Sprite, ...]  # each within its own frame; an empty layer has no rows and columns

    @property
    def num_values(self) -> int:
        """Number of pixels of all pieces."""
        return sum(piece.num_values for piece in self.pieces)


def read_pieces(folder: str | Path) -> Pieces:
    """Read a folder of layers or sprites."""
    if (Path(folder) / layer_folders.LAYERS_INDEX).is_file():
        return pieces_of_layers(layer_folders.read_layers(folder))
    if (Path(folder) / layer_folders.SPRITES_INDEX).is_file():
        sprites = layer_folders.read_sprites(folder)
        return Pieces(sprites.canvas, Kind.SPRITES, sprites.sprites)
    indices = f"{layer_folders.LAYERS_INDEX} or {layer_folders.SPRITES_INDEX}"
    raise ConfigError(f"{folder}: a folder without {indices}")


def write_pieces(folder: Path, scene: Pieces) -> None:
    """Write a folder of layers or sprites; inverse of `read_pieces`."""
    if scene.kind is Kind.LAYERS:
        layer_folders.write_layers(folder, layers_of(scene))
    else:
        layer_folders.write_sprites(folder, SpriteSet(scene.canvas, scene.pieces))


def pieces_of_layers(image: LayeredDepthImage) -> Pieces:
    """Return the layers of an image, each within its bounding rectangle."""
    pieces = []
    for colour, disparity, mask in zip(image.colour, image.disparity, image.occupied, strict=True):
        left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
        inside = slice(top, top + height), slice(left, left + width)
        pieces.append(Sprite(left, top, mask[inside], colour[inside], disparity[inside]))
    return Pieces(image.canvas, Kind.LAYERS, tuple(pieces))


def layers_of(scene: Pieces) -> LayeredDepthImage:
    """Return layers as an image, with each layer moved behind the one before."""
    shape = (len(scene.pieces), *scene.canvas.shape)
    colour, votes = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint8)
    disparity = np.zeros(shape, np.float32)
    for layer, piece in enumerate(scene.pieces):
        mask, values = piece.mask, piece.disparity
        index = (layer, *piece.slices)
        if layer:
            before = (layer - 1, *piece.slices)
            mask = mask & (votes[before] > 0)
            values = np.minimum(values, np.nextafter(disparity[before], np.float32(-np.inf)))
        votes[index] = mask
        disparity[index] = np.where(mask, values, np.float32(0.0))
        colour[index] = piece.colour * mask[..., None]
    return LayeredDepthImage(scene.canvas, colour, disparity, votes)


class Bounds(NamedTuple):
    """Range of m and n of the viewpoint."""

    left: float
    right: float
    top: float
    bottom: float


def bounds_around(left: float, right: float, top: float, bottom: float) -> Bounds:
    """Return bounds a bit beyond the lattice of several views."""
    beyond = BEYOND * max(right - left, bottom - top)
    return Bounds(left - beyond, right + beyond, top - beyond, bottom + beyond)


def bounds_of_one(width: int, extent: float) -> Bounds:
    """Return bounds around a single view, by its parallax."""
    reach = ACROSS * width / extent
    return Bounds(-reach, reach, -reach, reach)


def bounds_of_pieces(scene: Pieces) -> Bounds:
    """Return bounds a bit beyond the cameras that saw pixels beyond the frame; else those around one view."""
    frame, step = scene.canvas.frame, scene.canvas.labels.step
    disparity = np.concatenate([np.zeros(0), *(piece.disparity[piece.mask] for piece in scene.pieces)])
    ends = []
    for axis, first, size in ((1, frame.left, frame.width), (0, frame.top, frame.height)):
        positions = [
            np.nonzero(piece.mask)[axis] + (piece.top, piece.left)[axis] - first for piece in scene.pieces
        ]
        position = np.concatenate([np.zeros(0), *positions])
        beyond = position - np.clip(position, 0, size - 1)
        counts = (beyond != 0) & (np.abs(disparity) >= step)
        needed = np.append(0.0, beyond[counts] / disparity[counts])
        ends += [min(float(np.quantile(needed, STRAYS)), 0.0)]
        ends += [max(float(np.quantile(needed, 1.0 - STRAYS)), 0.0)]
    if max(map(abs, ends)) > 0.0:
        return bounds_around(*ends)
    extent = float(np.ptp(disparity)) if disparity.size else 0.0
    return bounds_of_one(frame.width, max(extent, scene.canvas.resolution) or 1.0)


def render_pieces(scene: Pieces, viewpoint: LatticePosition) -> SynthesisedView:
    """Render a view of pieces."""
    return filled(draw_pieces(scene, viewpoint), viewpoint)


def luma_from(scene: Pieces, viewpoint: LatticePosition) -> Floats:
    """Render the luma of a view."""
    return luma(picture_of(render_pieces(scene, viewpoint))).astype(np.float64)


class DrawnPieces(NamedTuple):
    """A view of pieces before holes are filled."""

    image: Floats  # levels; 0 in holes
    inverse_depth: Floats  # `EMPTY` in holes
    piece: NDArray[np.int64]  # number of the piece that is seen; -1 in holes
    rows: NDArray[np.int64]  # row and column in that piece
    columns: NDArray[np.int64]


def draw_pieces(scene: Pieces, viewpoint: LatticePosition) -> DrawnPieces:
    """Draw pieces forward, near over far."""
    frame, resolution = scene.canvas.frame, scene.canvas.resolution
    shape = frame.height, frame.width
    nearest, image = np.full(shape, EMPTY), np.zeros((*shape, 3))
    shown = np.full((3, *shape), -1, np.int64)
    for number, piece in enumerate(scene.pieces):
        if not piece.mask.any():
            continue
        height, width = piece.mask.shape
        left, top = piece.left - frame.left, piece.top - frame.top
        is_around = min(-left, -top, left + width - frame.width, top + height - frame.height) >= 0
        margin = 0 if is_around and piece.mask.all() else _MARGIN  # drawn like a picture, or as a part
        around = (margin, margin), (margin, margin)
        mask = np.pad(piece.mask, around)
        picture = with_margin(np.pad(piece.colour, (*around, (0, 0))), mask)
        disparity = np.pad(piece.disparity.astype(np.float64), around)
        warp = lattice_warp(LatticePosition(0.0, 0.0), viewpoint)
        warp[:2, 2] += left - margin, top - margin
        source = PictureWithDepth(picture, np.where(mask, disparity, EMPTY), warp, resolution)
        depth = drawn_depth(source, shape)
        rows, columns = np.nonzero(depth > nearest)
        nearest[rows, columns] = depth[rows, columns]
        positions = warp_grid(inverse_warp(source.warp), np.where(depth > EMPTY, depth, 0.0))
        chosen = np.ascontiguousarray(positions[rows, columns][np.newaxis])
        for channel in range(3):
            plane = np.ascontiguousarray(source.image[..., channel])
            image[rows, columns, channel] = sample(plane, chosen)[0]
        seen = np.rint(chosen[0, :, 1::-1].T).astype(np.int64) - margin
        shown[0, rows, columns] = number
        shown[1, rows, columns] = np.clip(seen[0], 0, height - 1)
        shown[2, rows, columns] = np.clip(seen[1], 0, width - 1)
    return DrawnPieces(image, nearest, *shown)


def filled(drawn: DrawnPieces, viewpoint: LatticePosition) -> SynthesisedView:
    """Fill the holes of a view."""
    epipole = np.array([-viewpoint.m, -viewpoint.n, 0.0])
    image, inverse_depth = fill_from_background(drawn.image, drawn.inverse_depth, epipole)
    return SynthesisedView(image, inverse_depth, drawn.inverse_depth > EMPTY)
