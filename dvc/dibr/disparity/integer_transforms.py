"""Integer wavelet transforms of disparity maps: Laplace (L) and sequential (S), in one and two dimensions.

Level 0 is the map itself; each node of level j has up to 2 x 2 children in level j - 1, fewer at odd borders.
In L each sample has a high-pass coefficient; in S those at even rows and columns are 0 ([Maitre2008] Eqs.
(3.13) to (3.16) and (3.32), Figure 3.7(b)).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.images.lifting import most_levels, scale_shapes

Labels = NDArray[np.int32]


def level_shapes(shape: tuple[int, int], num_levels: int | None = None) -> list[tuple[int, int]]:
    """Return the sizes of all levels."""
    most = most_levels(shape)
    return scale_shapes(shape, most if num_levels is None else min(num_levels, most))


@dataclass(frozen=True)
class IntegerTransform:
    """The synthesis of one level of a transform."""

    name: str  # name on command lines
    # samples of the next level, and high-pass coefficients (H, W), both int32, to samples (H, W)
    synthesise: Callable[[Labels, Labels], Labels]


def synthesise_s(low: Labels, high: Labels, axis: int) -> Labels:
    """Return the samples of means and differences of pairs along an axis (3.15), (3.16)."""
    low, high = np.moveaxis(low, axis, 0), np.moveaxis(high, axis, 0)
    samples = np.empty((len(low) + len(high), *low.shape[1:]), np.int32)
    samples[0::2] = low
    second = low[: len(high)] - (high >> 1)
    samples[1::2] = second
    samples[0 : 2 * len(high) : 2] = second + high
    return np.moveaxis(samples, 0, axis)


def spread(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the values of nodes for each of their children, which have a given shape."""
    return values.repeat(2, axis=0)[: shape[0]].repeat(2, axis=1)[:, : shape[1]]


L_TRANSFORM = IntegerTransform("l", lambda low, high: np.asarray(spread(low, high.shape) + high))
"""Laplace: floor of the mean, and the difference of each sample from it (3.13), (3.14), (3.32)."""

S_TRANSFORM = IntegerTransform(
    "s", lambda low, high: synthesise_s(synthesise_s(low, high[0::2, 1::2], 1), high[1::2], 0)
)
"""Sequential: vertically on both columns, then horizontally on the low-pass coefficients (3.15), (3.16)."""


@dataclass(frozen=True, eq=False)
class WaveletTree:
    """A map of labels as wavelet coefficients; any integers make one."""

    transform: IntegerTransform  # L or S
    num_labels: int  # labels are from 0 to ``num_labels - 1``
    roots: Labels  # low-pass coefficients of the coarsest level
    highs: tuple[Labels, ...]  # high-pass coefficients of level 0, 1, ...

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        rows, columns = (self.highs[0] if self.highs else self.roots).shape
        return rows, columns

    def levels(self, first: int = 0) -> list[Labels]:
        """Return the low-pass coefficients of all levels from one on, by synthesis."""
        levels = [self.roots]
        for high in reversed(self.highs[first:]):
            levels.append(self.transform.synthesise(levels[-1], high))
        return levels[::-1]

    def disparity(self, level: int = 0) -> Labels:
        """Return the map of labels."""
        return np.clip(self.levels(level)[0], 0, self.num_labels - 1)
