"""Layers and sprites of the values that are worth their bits, for streams of a given length.

Scenes are coded, decoded and looked at from views that stand for all that a viewer can take: first the
reference view with its disparities alone, which costs least, as they are and rounded to the labels that were
tried, as means of what cameras have voted for cost more; then, with the better ones of these, what is worth
its bits at the Lagrange multiplier of its picture, and at larger and smaller ones as long as views become
better; last all values as they are, if their masks leave enough to the rest. The best one is written, so it
is never worse than the picture with its map.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from dvc.dibr.depth_image import piece_encoder as encoder
from dvc.dibr.depth_image.piece_decoder import decode
from dvc.dibr.depth_image.piece_encoder import EncodedPieces, LayeredOptions
from dvc.dibr.depth_image.piece_stream import decode_stream
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces
from dvc.dibr.layered.simplification import Price, Simplified, alone, simplify
from dvc.dibr.layered.stack import (
    Floats,
    Stack,
    luma_from,
    rounded_to_labels,
    stack_of,
    viewpoints_of,
    worth_of,
)
from dvc.errors import ConfigError
from dvc.geometry.camera_array import LatticePosition
from dvc.images.colour import luma

MOST_TRIALS = 8
"""Scenes that are coded, at most."""

_FIRST, _STEP, _SMALLEST = 4.0, 4.0, 1.0 / 64.0
"""Multipliers that are tried, in units of the picture's: contours take bits from the map as well."""


@dataclass(frozen=True, eq=False)
class SelectedPieces:
    """A stream, and what it holds of a scene."""

    encoded: EncodedPieces  # the stream
    scene: Pieces  # what was coded
    squared_error: float  # of luma of other views, against those of all that was given


def encode_best(
    scene: Pieces,
    max_bytes: int,
    options: LayeredOptions | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> SelectedPieces:
    """Code the layers or sprites that are worth their bytes."""
    chosen = options or LayeredOptions()
    if not scene.num_values:
        advance(MOST_TRIALS)
        return SelectedPieces(encoder.encode_to_size(scene, max_bytes, chosen), scene, 0.0)
    trials = _Trials(scene, max_bytes, chosen, advance)
    stack, found = _reference(trials, stack_of(scene), scene.kind)
    worth = worth_of(stack, found.scene, trials.viewpoints)
    price = _price(found)

    def _at(factor: float) -> SelectedPieces:
        simplified = simplify(stack, scene.kind, worth, price._replace(multiplier=factor * price.multiplier))
        if simplified.scene.num_values == found.scene.num_values:  # nothing is worth its bits
            return found
        try:
            return trials.of(simplified)
        except ConfigError:  # does not fit
            return replace(found, squared_error=np.inf)

    first = _at(_FIRST)
    tried = [found, first, _at(_FIRST * _STEP)]
    factor, before = _FIRST / _STEP, first
    while factor >= _SMALLEST and trials.left > 1 and before is min(tried, key=lambda one: one.squared_error):
        before = _at(factor)
        tried.append(before)
        factor /= _STEP
    if encoder.mask_bytes(scene) <= chosen.depth_share * max_bytes:
        with suppress(ConfigError):
            tried.insert(0, trials.of(Simplified(scene, (1.0,) * len(scene.pieces))))
    advance(trials.left)
    return min(tried, key=lambda one: one.squared_error)


class _Trials:
    """Scenes coded, and looked at."""

    def __init__(
        self, scene: Pieces, max_bytes: int, options: LayeredOptions, advance: Callable[[int], None]
    ) -> None:
        self.viewpoints: list[LatticePosition] = viewpoints_of(scene)
        self.left = MOST_TRIALS
        self._views: list[Floats] = [luma_from(scene, viewpoint) for viewpoint in self.viewpoints]
        self._max_bytes, self._options, self._advance = max_bytes, options, advance

    def of(self, simplified: Simplified) -> SelectedPieces:
        """Code a scene."""
        self.left -= 1
        self._advance(1)
        encoded = encoder.encode_to_size(
            simplified.scene, self._max_bytes, self._options, weights=simplified.weights
        )
        decoded = decode(decode_stream(encoded.data)).scene
        errors = [
            float(np.mean((luma_from(decoded, viewpoint) - view) ** 2))
            for viewpoint, view in zip(self.viewpoints, self._views, strict=True)
        ]
        return SelectedPieces(encoded, simplified.scene, float(np.mean(errors)))


def _reference(trials: _Trials, stack: Stack, kind: Kind) -> tuple[Stack, SelectedPieces]:
    """The reference view with its disparities, and all values with disparities like those."""
    found = stack, trials.of(Simplified(alone(stack, kind), (1.0,)))
    rounded = rounded_to_labels(stack)
    if not np.array_equal(rounded.disparity, stack.disparity):
        other = trials.of(Simplified(alone(rounded, kind), (1.0,)))
        if other.squared_error < found[1].squared_error:
            return rounded, other
    return found


def _price(coded: SelectedPieces) -> Price:
    """What a pixel costs, by what the reference view with its disparities has cost."""
    encoded, (piece,) = coded.encoded, coded.scene.pieces
    (decoded,) = decode(decode_stream(encoded.data)).scene.pieces
    error = luma(decoded.colour).astype(np.float64) - luma(piece.colour)
    num_bytes = encoded.part_bytes["image"] + encoded.part_bytes["depth"]
    return Price(encoded.multiplier, 8.0 * num_bytes / piece.mask.size, float(np.mean(error**2)))
