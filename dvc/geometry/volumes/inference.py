"""Inference of one label for each pixel from a cost volume: what methods have in common."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.inference import semi_global
from dvc.geometry.volumes import _kernels

Volume = NDArray[np.float32]
Labels = NDArray[np.int64]

UNITS = 100.0
"""Steps of a whole-number cost in a cost of 1."""


class Inferred(NamedTuple):
    """Labels of all pixels."""

    label: Labels  # the best one
    offset: NDArray[np.float32]  # where between its neighbours the smallest cost lies, from -0.5 to 0.5

    def rows(self, kept: slice) -> "Inferred":
        """Return some rows."""
        return Inferred(self.label[kept], self.offset[kept])


class Inference(Protocol):
    """Chooses labels of small cost that are smooth but for discontinuities (2.13)."""

    def infer(self, cost: Volume, image: NDArray[np.uint8], base: Labels, origin: Labels) -> Inferred:
        """Choose labels.

        Parameters
        ----------
        cost : ndarray of shape (rows, columns, labels), float32
            Cost of each label, from 0 to about 2.
        image : ndarray of shape (rows, columns, 3), uint8
            Across whose edges jumps are cheap.
        base : ndarray of shape (rows, columns), int64
            Labels of a base surface, whose slopes cost nothing where the method can tell.
        origin : ndarray of shape (rows, columns), int64
            Label of the first cost of each pixel.

        Returns
        -------
        Inferred
            Labels.
        """


@dataclass(frozen=True)
class SemiGlobal:
    """Dynamic programming along eight scanlines: fast, and even where costs say little."""

    small_jump: float = 0.3  # cost of a change by one label, and of a larger one across equal levels
    large_jump: float = 2.0

    def infer(self, cost: Volume, image: NDArray[np.uint8], base: Labels, origin: Labels) -> Inferred:
        """Choose labels; see `Inference`. The base surface is not looked at: what is even costs nothing."""
        del base
        small, large = round(self.small_jump * UNITS), round(self.large_jump * UNITS)
        red, green, blue = np.moveaxis(image.astype(np.int64), 2, 0)
        luma = ((299 * red + 587 * green + 114 * blue + 500) // 1000).astype(np.uint8)
        hypothesis, _ = semi_global((cost * UNITS).astype(np.int16), luma, small, large)
        label = np.floor(hypothesis + 0.5).astype(np.int64)
        return Inferred(label + origin, (hypothesis - label).astype(np.float32))


def chosen(total: Volume, origin: Labels) -> Inferred:
    """Choose the best label of each pixel."""
    shape = total.shape[:2]
    inferred = Inferred(np.empty(shape, np.int64), np.empty(shape, np.float32))
    _kernels.choose(total, *inferred)
    return inferred._replace(label=inferred.label + origin)
