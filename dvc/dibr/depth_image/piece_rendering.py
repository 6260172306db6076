"""Rendering of layers and sprites: each piece is drawn forward, near over far."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.piece_stream import DecodedPieces
from dvc.dibr.depth_image.scene_pieces import Pieces
from dvc.dibr.view_rendering import picture_of, with_margin
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import PictureWithDepth, SynthesisedView, drawn_depth, fill_from_background
from dvc.geometry.viewpoints import Viewpoint, lattice_warp
from dvc.geometry.warping import EMPTY, inverse_warp, sample, warp_grid
from dvc.images.colour import luma
from dvc.layers.canvas import Frame
from dvc.layers.sprites import Sprite

Floats = NDArray[np.float64]

_MARGIN = 1
"""Pixels around a piece for the outer halves of its pixels: other pieces may begin there."""


def render(decoded: DecodedPieces, viewpoint: Viewpoint) -> SynthesisedView:
    """Render a view of a decoded stream."""
    assert isinstance(viewpoint, LatticePosition), "layers and sprites are rectified"
    return render_pieces(decoded.scene, viewpoint)


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
        margin = 0 if _covers(piece, frame) else _MARGIN
        source = _source(piece, viewpoint, (frame.left, frame.top), resolution, margin)
        depth = drawn_depth(source, shape)
        rows, columns = np.nonzero(depth > nearest)
        nearest[rows, columns] = depth[rows, columns]
        positions = warp_grid(inverse_warp(source.warp), np.where(depth > EMPTY, depth, 0.0))
        chosen = np.ascontiguousarray(positions[rows, columns][np.newaxis])
        for channel in range(3):
            plane = np.ascontiguousarray(source.image[..., channel])
            image[rows, columns, channel] = sample(plane, chosen)[0]
        seen = np.rint(chosen[0, :, 1::-1].T).astype(np.int64) - margin
        height, width = piece.mask.shape
        shown[0, rows, columns] = number
        shown[1, rows, columns] = np.clip(seen[0], 0, height - 1)
        shown[2, rows, columns] = np.clip(seen[1], 0, width - 1)
    return DrawnPieces(image, nearest, *shown)


def filled(drawn: DrawnPieces, viewpoint: LatticePosition) -> SynthesisedView:
    """Fill the holes of a view."""
    epipole = np.array([-viewpoint.m, -viewpoint.n, 0.0])
    image, inverse_depth = fill_from_background(drawn.image, drawn.inverse_depth, epipole)
    return SynthesisedView(image, inverse_depth, drawn.inverse_depth > EMPTY)


def _covers(piece: Sprite, frame: Frame) -> bool:
    """Return whether a piece covers all of the frame; it is then drawn like a picture, without a margin."""
    height, width = piece.mask.shape
    across = piece.left <= frame.left and piece.left + width >= frame.left + frame.width
    down = piece.top <= frame.top and piece.top + height >= frame.top + frame.height
    return across and down and bool(piece.mask.all())


def _source(
    piece: Sprite, viewpoint: LatticePosition, origin: tuple[int, int], resolution: float, margin: int
) -> PictureWithDepth:
    """Return a piece with a margin, and its warp to the target view."""
    around = ((margin, margin), (margin, margin))
    mask = np.pad(piece.mask, around)
    picture = with_margin(np.pad(piece.colour, (*around, (0, 0))), mask)
    disparity = np.pad(piece.disparity.astype(np.float64), around)
    warp = lattice_warp(LatticePosition(0.0, 0.0), viewpoint)
    warp[:2, 2] += piece.left - origin[0] - margin, piece.top - origin[1] - margin
    return PictureWithDepth(picture, np.where(mask, disparity, EMPTY), warp, resolution)
