"""Values of layers or sprites sorted by pixel, from near to far, and what they are worth in other views."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.piece_rendering import draw_pieces, filled, render_pieces
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces
from dvc.dibr.layered.bounds import bounds_of_pieces
from dvc.dibr.view_rendering import picture_of
from dvc.geometry.camera_array import LatticePosition
from dvc.images.colour import luma
from dvc.layers.canvas import Canvas
from dvc.layers.sprites import Sprite

_CELLS = 3
"""Views of the encoder are from the middles of so many cells of the viewer's bounds, squared."""

Floats = NDArray[np.float64]


class Stack(NamedTuple):
    """Values of all pixels of a canvas, from near to far."""

    canvas: Canvas  # where they are
    colour: NDArray[np.uint8]  # red, green and blue
    disparity: NDArray[np.float32]  # in pixels per unit of m
    occupied: NDArray[np.bool_]  # where there are values; wherever there is one, there is one before


class Worth(NamedTuple):
    """What the values of a stack are worth in other views."""

    # squared error of luma where a value is seen, on the mean of the views, if there is only the reference
    # view with its disparities
    saved: Floats
    seen: Floats  # how many pixels of a view show it, on the mean


def stack_of(scene: Pieces) -> Stack:
    """Sort the values of pieces."""
    height, width = scene.canvas.shape
    offsets, colours, disparities = [], [], []
    for piece in scene.pieces:
        rows, columns = np.nonzero(piece.mask)
        offsets.append((rows + piece.top) * width + columns + piece.left)
        colours.append(piece.colour[piece.mask])
        disparities.append(piece.disparity[piece.mask])
    offset, disparity = np.concatenate(offsets), np.concatenate(disparities)
    order = np.lexsort((-disparity, offset))
    offset = offset[order]
    first = np.flatnonzero(np.concatenate([[True], offset[1:] != offset[:-1]]))
    layer = np.arange(len(offset)) - np.repeat(first, np.diff(np.append(first, len(offset))))
    shape = int(layer.max()) + 1, height * width
    stack = Stack(
        scene.canvas, np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    )
    stack.colour[layer, offset] = np.concatenate(colours)[order]
    stack.disparity[layer, offset] = disparity[order]
    stack.occupied[layer, offset] = True
    size = shape[0], height, width
    return Stack(
        scene.canvas,
        stack.colour.reshape(*size, 3),
        stack.disparity.reshape(size),
        stack.occupied.reshape(size),
    )


def rounded_to_labels(stack: Stack) -> Stack:
    """Round disparities to those that were tried."""
    lowest, step, _ = stack.canvas.labels
    labels = lowest + step * np.rint((stack.disparity.astype(np.float64) - lowest) / step)
    return stack._replace(disparity=np.where(stack.occupied, labels, 0.0).astype(np.float32))


def viewpoints_of(scene: Pieces) -> list[LatticePosition]:
    """Return views that stand for all from which a scene may be looked at."""
    bounds = bounds_of_pieces(scene)
    shares = (np.arange(_CELLS) + 0.5) / _CELLS
    across = bounds.left + shares * (bounds.right - bounds.left)
    down = bounds.top + shares * (bounds.bottom - bounds.top)
    return [LatticePosition(float(m), float(n)) for n in down for m in across]


def luma_from(scene: Pieces, viewpoint: LatticePosition) -> Floats:
    """Render the luma of a view."""
    return luma(picture_of(render_pieces(scene, viewpoint))).astype(np.float64)


def worth_of(stack: Stack, alone: Pieces, viewpoints: Sequence[LatticePosition]) -> Worth:
    """Find what values are worth."""
    pieces = tuple(
        Sprite(0, 0, *values) for values in zip(stack.occupied, stack.colour, stack.disparity, strict=True)
    )
    whole = Pieces(stack.canvas, Kind.LAYERS, pieces)
    worth = Worth(np.zeros(stack.occupied.shape), np.zeros(stack.occupied.shape))
    for viewpoint in viewpoints:
        drawn = draw_pieces(whole, viewpoint)
        picture = luma(picture_of(filled(drawn, viewpoint))).astype(np.float64)
        error = (picture - luma_from(alone, viewpoint)) ** 2
        known = drawn.piece >= 0
        index = drawn.piece[known], drawn.rows[known], drawn.columns[known]
        np.add.at(worth.saved, index, error[known] / len(viewpoints))
        np.add.at(worth.seen, index, 1.0 / len(viewpoints))
    return worth
