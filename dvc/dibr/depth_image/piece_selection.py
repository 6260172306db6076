"""Values of layers and sprites that are worth their bits, for streams of a given length.

Values behind the nearest ones are coded if the error that they save in other views is worth their bits.
Scenes at several multipliers, the reference view only, and all values are coded; the best one is written.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats, Mask
from dvc.dibr.depth_image.depth_image_encoder import DEPTH_SHARE, DepthOptions
from dvc.dibr.depth_image.piece_encoder import EncodedPieces, encode_to_size, mask_bytes
from dvc.dibr.depth_image.piece_stream import decode, decode_stream
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, bounds_of_pieces, draw_pieces, filled, luma_from
from dvc.dibr.view_rendering import picture_of
from dvc.errors import ConfigError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import fill_from_background
from dvc.geometry.warping import EMPTY
from dvc.images.colour import luma
from dvc.images.edge_selection import CHAIN_BITS, ELEMENT_BITS
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.sprites import Sprite

FACTORS = 16.0, 4.0, 1.0, 0.25, 0.0625
"""Multipliers to try, relative to that of the picture: contours take bits from the map as well."""
MOST_TRIALS = 3 + len(FACTORS)
"""Most scenes that are coded."""
PIECE_BITS = 8.0 * 28.0
"""Bits of a piece besides its edges and its code."""
_CELLS = 3
"""Views are from the middles of this number of cells, squared, of the bounds of the viewer."""
_PASSES = 8
"""Passes over a mask."""
_HORIZONTAL = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class SelectedPieces:
    """A stream, and the scene that it holds."""

    encoded: EncodedPieces
    scene: Pieces
    squared_error: float  # error of the luma of other views, compared with all given values


def encode_best(
    scene: Pieces,
    max_bytes: int,
    options: DepthOptions | None = None,
    advance: Callable[[int], None] = lambda _: None,
    gray: bool = False,
) -> SelectedPieces:
    """Code the layers or sprites that are worth their bytes."""
    chosen, done = options or DepthOptions(), 0
    if not scene.num_values:
        advance(MOST_TRIALS)
        return SelectedPieces(encode_to_size(scene, max_bytes, chosen, gray=gray), scene, 0.0)
    viewpoints = viewpoints_of(scene)
    views = [luma_from(scene, viewpoint) for viewpoint in viewpoints]

    def _try(candidate: Pieces, weights: Sequence[float] | None = None) -> SelectedPieces:
        nonlocal done
        done += 1
        advance(1)
        encoded = encode_to_size(candidate, max_bytes, chosen, weights=weights, gray=gray)
        decoded = decode(decode_stream(encoded.data)).scene
        errors = [
            float(np.mean((luma_from(decoded, viewpoint) - view) ** 2))
            for viewpoint, view in zip(viewpoints, views, strict=True)
        ]
        return SelectedPieces(encoded, candidate, float(np.mean(errors)))

    stack = stack_of(scene)
    best = _try(reference_of(stack, scene.kind))
    rounded = rounded_to_labels(stack)
    if not np.array_equal(rounded.disparity, stack.disparity):
        other = _try(reference_of(rounded, scene.kind))
        if other.squared_error < best.squared_error:
            stack, best = rounded, other
    reference = best
    worth, coded, (piece,) = worth_of(stack, reference.scene, viewpoints), best.encoded, best.scene.pieces
    (shown,) = decode(decode_stream(coded.data)).scene.pieces
    error = luma(shown.colour).astype(np.float64) - luma(piece.colour)
    num_bytes = coded.part_bytes["image"] + coded.part_bytes["depth"]
    price = Price(coded.multiplier, 8.0 * num_bytes / piece.mask.size, float(np.mean(error**2)))
    for factor in FACTORS:
        scaled = price._replace(multiplier=factor * price.multiplier)
        selected, weights = select(stack, scene.kind, worth, scaled)
        if selected.num_values == reference.scene.num_values:  # nothing is worth its bits
            continue
        with suppress(ConfigError):  # does not fit
            trial = _try(selected, weights)
            if trial.squared_error > best.squared_error and factor < FACTORS[1]:
                break
            best = min(trial, best, key=lambda one: one.squared_error)
    if mask_bytes(scene) <= (chosen.depth_share or DEPTH_SHARE) * max_bytes:
        with suppress(ConfigError):
            best = min(_try(scene), best, key=lambda one: one.squared_error)
    advance(MOST_TRIALS - done)
    return best


def viewpoints_of(scene: Pieces) -> list[LatticePosition]:
    """Return viewpoints that represent the bounds of the viewer."""
    bounds = bounds_of_pieces(scene)
    shares = (np.arange(_CELLS) + 0.5) / _CELLS
    across = bounds.left + shares * (bounds.right - bounds.left)
    down = bounds.top + shares * (bounds.bottom - bounds.top)
    return [LatticePosition(float(m), float(n)) for n in down for m in across]


class Stack(NamedTuple):
    """Values of all pixels of a canvas, from near to far."""

    canvas: Canvas
    colour: NDArray[np.uint8]  # red, green and blue
    disparity: NDArray[np.float32]  # pixels per unit of m
    occupied: Mask  # pixels of a layer with a value; those of the next layer are among them


def stack_of(scene: Pieces) -> Stack:
    """Sort the values of pieces."""
    height, width = scene.canvas.shape
    offsets = []
    for piece in scene.pieces:
        rows, columns = np.nonzero(piece.mask)
        offsets.append((rows + piece.top) * width + columns + piece.left)
    offset = np.concatenate(offsets)
    disparity = np.concatenate([piece.disparity[piece.mask] for piece in scene.pieces])
    order = np.lexsort((-disparity, offset))
    offset = offset[order]
    first = np.flatnonzero(np.concatenate([[True], offset[1:] != offset[:-1]]))
    layer = np.arange(len(offset)) - np.repeat(first, np.diff(np.append(first, len(offset))))
    shape = int(layer.max()) + 1, height, width
    index = layer, *np.unravel_index(offset, (height, width))
    values = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    stack = Stack(scene.canvas, *values)
    stack.colour[index] = np.concatenate([piece.colour[piece.mask] for piece in scene.pieces])[order]
    stack.disparity[index] = disparity[order]
    stack.occupied[index] = True
    return stack


def rounded_to_labels(stack: Stack) -> Stack:
    """Round disparities to labels."""
    lowest, step, _ = stack.canvas.labels
    labels = lowest + step * np.rint((stack.disparity.astype(np.float64) - lowest) / step)
    return stack._replace(disparity=np.where(stack.occupied, labels, 0.0).astype(np.float32))


def reference_of(stack: Stack, kind: Kind) -> Pieces:
    """Return the nearest values within the frame, as one piece."""
    return Pieces(stack.canvas, kind, (_front(stack, stack.canvas.frame),))


class Worth(NamedTuple):
    """Worth of the values of a stack in other views, means over these."""

    # squared error of luma of the reference view with its disparities, at pixels that show a value
    saved: Floats
    seen: Floats  # number of pixels that show a value


def worth_of(stack: Stack, reference: Pieces, viewpoints: Sequence[LatticePosition]) -> Worth:
    """Return the worth of values."""
    pieces = tuple(
        Sprite(0, 0, *values) for values in zip(stack.occupied, stack.colour, stack.disparity, strict=True)
    )
    whole = Pieces(stack.canvas, Kind.LAYERS, pieces)
    worth = Worth(np.zeros(stack.occupied.shape), np.zeros(stack.occupied.shape))
    for viewpoint in viewpoints:
        drawn = draw_pieces(whole, viewpoint)
        picture = luma(picture_of(filled(drawn, viewpoint))).astype(np.float64)
        error = (picture - luma_from(reference, viewpoint)) ** 2
        known = drawn.piece >= 0
        index = drawn.piece[known], drawn.rows[known], drawn.columns[known]
        np.add.at(worth.saved, index, error[known] / len(viewpoints))
        np.add.at(worth.seen, index, 1.0 / len(viewpoints))
    return worth


class Price(NamedTuple):
    """Price of pixels."""

    multiplier: float  # squared error, of all pixels of a view together, that a bit is worth
    bits_per_pixel: float  # bits of picture and disparities
    squared_error: float  # error of a coded pixel


def select(stack: Stack, kind: Kind, worth: Worth, price: Price) -> tuple[Pieces, list[float]]:
    """Return the scene of values that are worth their bits, and weights of its pieces by their visibility."""
    from scipy.ndimage import distance_transform_edt

    cost = price.multiplier * price.bits_per_pixel
    profit = np.where(stack.occupied, worth.saved - price.squared_error * worth.seen, 0.0) - cost
    window = _window(stack.canvas, profit[0])
    pieces, weights = [_front(stack, window)], [1.0]
    inside = np.ones((window.height, window.width), np.bool_)
    seen = float(worth.seen[0][window.slices].mean())
    behind = pieces[0].disparity
    for layer in range(1, len(stack.occupied)):
        allowed = np.where(inside, profit[layer][window.slices], -np.inf)
        inside = best_mask(allowed, price.multiplier * ELEMENT_BITS, price.multiplier * CHAIN_BITS)
        if allowed[inside].sum() <= price.multiplier * PIECE_BITS:
            break
        missing = ~stack.occupied[layer][window.slices]
        nearest = tuple(distance_transform_edt(missing, return_distances=False, return_indices=True))
        disparity = stack.disparity[layer][window.slices][nearest]
        behind = np.minimum(disparity, behind - np.float32(0.5 * stack.canvas.resolution))
        left, top, width, height = cv2.boundingRect(inside.astype(np.uint8))
        part = np.s_[top : top + height, left : left + width]
        mask = inside[part]
        colour = stack.colour[layer][window.slices][nearest][part] * mask[..., None]
        pieces.append(Sprite(window.left + left, window.top + top, mask, colour, behind[part] * mask))
        weights.append(float(worth.seen[layer][window.slices][inside].mean()) / seen)
    return Pieces(stack.canvas, kind, tuple(pieces)), weights


def _window(canvas: Canvas, profit: Floats) -> Frame:
    """Return the frame with the rows and columns around it that are worth their bits."""
    left, top, width, height = canvas.frame
    across, down = slice(left, left + width), slice(top, top + height)
    columns, rows = profit[down].sum(axis=0), profit[:, across].sum(axis=1)
    more = [
        int(np.argmax(np.concatenate([[0.0], np.cumsum(lines)])))
        for lines in (columns[:left][::-1], columns[left + width :], rows[:top][::-1], rows[top + height :])
    ]
    return Frame(left - more[0], top - more[2], width + more[0] + more[1], height + more[2] + more[3])


def _front(stack: Stack, window: Frame) -> Sprite:
    """Return the nearest values in a window, continued into pixels without any."""
    known = stack.occupied[0][window.slices]
    colour, disparity = stack.colour[0][window.slices], stack.disparity[0][window.slices]
    if not known.all():
        depth = np.where(known, disparity.astype(np.float64), EMPTY)
        levels, depth = fill_from_background(colour.astype(np.float64), depth, _HORIZONTAL)
        colour = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        disparity = depth.astype(np.float32)
    return Sprite(window.left, window.top, np.ones(known.shape, np.bool_), colour, disparity)


def best_mask(profit: Floats, edge_cost: float, region_cost: float) -> Mask:
    """Return a mask of large profit, less the cost of its edges and regions."""
    # each pixel takes the better side for its neighbours, in turn for the two colours of a chessboard
    gain = np.clip(profit / edge_cost, -1e6, 1e6)
    inside = gain > 0.0
    odd = np.indices(inside.shape).sum(axis=0) % 2 > 0
    for number in range(_PASSES):
        chosen = gain + _neighbours(inside) > 0.0
        inside = np.where(odd if number % 2 else ~odd, chosen, inside)
    inside &= gain > -1e6
    number, labels = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    edges = 2.0 - 0.5 * _neighbours(inside)  # of a pixel inside, those to pixels outside
    total = np.bincount(labels[inside], (profit - edge_cost * edges)[inside], minlength=number)
    worth = total > region_cost
    worth[0] = False
    return np.asarray(worth[labels])


def _neighbours(mask: Mask) -> Floats:
    """Return the number of the four neighbours inside a mask less that outside; none beyond the border."""
    padded = np.pad(np.where(mask, 1.0, -1.0), 1)
    return np.asarray(padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:])
