"""Simpler layers and sprites: the reference view with its disparities, and hidden values worth their bits.

The nearest values of all pixels become one picture without a mask, a rectangle; values behind it are kept
where the error that they save in other views is worth their bits. There is one Lagrange
multiplier, that of the pictures, and no other parameter.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from dvc.dibr.depth_image.scene_pieces import Kind, Pieces
from dvc.dibr.layered.mask_selection import best_mask
from dvc.dibr.layered.stack import Stack, Worth
from dvc.geometry.hole_filling import fill_from_background
from dvc.geometry.rendering import EMPTY
from dvc.images.edge_selection import CHAIN_BITS, ELEMENT_BITS
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.sprites import Sprite

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

PIECE_BITS = 8.0 * 28.0
"""Of a piece, beside its edges and its code."""
_HORIZONTAL = np.array([1.0, 0.0, 0.0])


class Price(NamedTuple):
    """What pixels cost."""

    multiplier: float  # squared error, of all pixels of a view together, that a bit is worth
    bits_per_pixel: float  # of picture and disparities
    squared_error: float  # of a pixel that is coded


class Simplified(NamedTuple):
    """A simpler scene."""

    scene: Pieces  # the scene
    # what errors of each piece count: how much of it is seen in other views, beside the first one
    weights: tuple[float, ...]


def alone(stack: Stack, kind: Kind) -> Pieces:
    """Return the nearest values within the frame, as one piece."""
    return Pieces(stack.canvas, kind, (_front(stack, stack.canvas.frame),))


def simplify(stack: Stack, kind: Kind, worth: Worth, price: Price) -> Simplified:
    """Leave out what is not worth its bits."""
    cost = price.multiplier * price.bits_per_pixel
    profit = np.where(stack.occupied, worth.saved - price.squared_error * worth.seen, 0.0) - cost
    window = _window(stack.canvas, profit[0])
    pieces, weights = [_front(stack, window)], [1.0]
    inside = np.zeros(stack.canvas.shape, np.bool_)
    inside[window.slices] = True
    seen = float(worth.seen[0][inside].mean())
    behind = pieces[0].disparity
    for layer in range(1, len(stack.occupied)):
        allowed = np.where(inside, profit[layer], -np.inf)[window.slices]
        mask = best_mask(allowed, price.multiplier * ELEMENT_BITS, price.multiplier * CHAIN_BITS)
        if allowed[mask].sum() <= price.multiplier * PIECE_BITS:
            break
        colour, disparity = _continued(stack, layer, window)
        behind = np.minimum(disparity, behind - np.float32(0.5 * stack.canvas.resolution))
        pieces.append(_cut(Sprite(window.left, window.top, mask, colour, behind)))
        weights.append(float(worth.seen[layer][window.slices][mask].mean()) / seen)
        inside = np.zeros_like(inside)
        inside[window.slices] = mask
    return Simplified(Pieces(stack.canvas, kind, tuple(pieces)), tuple(weights))


def _window(canvas: Canvas, profit: Floats) -> Frame:
    """The frame with rows and columns beside it that are worth their bits."""
    left, top, width, height = canvas.frame
    across, down = slice(left, left + width), slice(top, top + height)
    columns, rows = profit[down].sum(axis=0), profit[:, across].sum(axis=1)
    more_left, more_right = _reach(columns[:left][::-1]), _reach(columns[left + width :])
    more_above, more_below = _reach(rows[:top][::-1]), _reach(rows[top + height :])
    return Frame(
        left - more_left, top - more_above, width + more_left + more_right, height + more_above + more_below
    )


def _reach(profit: Floats) -> int:
    """How many of some lines are worth their bits together."""
    return int(np.argmax(np.concatenate([[0.0], np.cumsum(profit)])))


def _front(stack: Stack, window: Frame) -> Sprite:
    """The nearest values in a window, continued where there is none."""
    known = stack.occupied[0][window.slices]
    colour, disparity = stack.colour[0][window.slices], stack.disparity[0][window.slices]
    if not known.all():
        depth = np.where(known, disparity.astype(np.float64), EMPTY)
        levels, depth = fill_from_background(colour.astype(np.float64), depth, _HORIZONTAL)
        colour = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        disparity = depth.astype(np.float32)
    return Sprite(window.left, window.top, np.ones(known.shape, np.bool_), colour, disparity)


def _continued(stack: Stack, layer: int, window: Frame) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """The values of a layer in a window; elsewhere the nearest ones."""
    missing = ~stack.occupied[layer][window.slices]
    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    colour, disparity = stack.colour[layer][window.slices], stack.disparity[layer][window.slices]
    return colour[rows, columns], disparity[rows, columns]


def _cut(piece: Sprite) -> Sprite:
    """A piece within the rectangle that its mask takes, with nothing outside the mask."""
    rows, columns = np.flatnonzero(piece.mask.any(axis=1)), np.flatnonzero(piece.mask.any(axis=0))
    top, left = int(rows[0]), int(columns[0])
    inside = np.s_[top : rows[-1] + 1, left : columns[-1] + 1]
    mask = piece.mask[inside]
    return Sprite(
        piece.left + left,
        piece.top + top,
        mask,
        piece.colour[inside] * mask[..., None],
        piece.disparity[inside] * mask,
    )
