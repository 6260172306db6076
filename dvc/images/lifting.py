"""Lifting: the 9/7 and 5/3 wavelet transforms of planes of any size; they may stop at edges.

Even samples become the low band, odd ones the high band. Each step changes one of the two cosets by the sum
of the neighbours in the other, so the same steps backward, with opposite signs, are the inverse whatever the
neighbours beyond a border are taken to be: those of the symmetric extension about the last sample.

What a step would take from beyond an edge is extrapolated from the samples of the same coset on this side
by a polynomial (4.4), so the inverse knows it too. With too few of them the polynomial has a lower degree.
In the last step details beyond an edge are taken to be zero, as if the polynomial fitted there; not so with
degree 0, which is the symmetric extension of shape-adaptive transforms. A sample of the low band that is
alone between edges is scaled as a constant is; one of the high band is predicted from beyond its edges.

With a mask, whose border is among the edges, there is nothing outside it: samples and coefficients there are
zero after each step, so that what is inside does not depend on them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, repeat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.images.column_lifting import lift_columns
from dvc.images.edge_maps import EdgeMaps, Flags

Plane = NDArray[np.float64]

Mask = NDArray[np.bool_]

_SAMPLES_AT_ONCE = 2**17  # that rows are merged of: planes may be large
MAX_ORDER = 3
"""Highest degree of the polynomials."""


@dataclass(frozen=True)
class Wavelet:
    """Weights of the lifting steps."""

    name: str  # as given on command lines
    weights: tuple[float, ...]  # of steps that change the odd and the even samples, in turn; (4.1), (4.2)
    gain: float  # of the low band for constant signals, before scaling

    @property
    def scales(self) -> tuple[float, float]:
        """Factors of the low and the high band that make the transform near-orthonormal (3.9)."""
        return math.sqrt(2.0) / self.gain, self.gain / math.sqrt(2.0)


WAVELETS = {
    "9/7": Wavelet(
        "9/7",
        (-1.586134342059924, -0.052980118572961, 0.882911075530934, 0.443506852043971),
        1.230174104914001,
    ),
    "5/3": Wavelet("5/3", (-0.5, 0.25), 1.0),
}


@dataclass(frozen=True)
class Details:
    """High bands of one scale."""

    horizontal: Plane  # high-pass along rows, low-pass along columns
    vertical: Plane  # the other way round
    diagonal: Plane  # high-pass along both

    @property
    def bands(self) -> tuple[Plane, Plane, Plane]:
        """The three of them in this order."""
        return self.horizontal, self.vertical, self.diagonal


@dataclass(frozen=True)
class Pyramid:
    """Coefficients of a plane."""

    low: Plane  # what is left of the plane at the coarsest scale
    details: tuple[Details, ...]  # high bands, the finest scale first


def scale_shapes(shape: tuple[int, int], num_levels: int) -> list[tuple[int, int]]:
    """Return the sizes of a plane at all scales."""
    shapes = [shape]
    for _ in range(num_levels):
        rows, columns = shapes[-1]
        shapes.append(((rows + 1) // 2, (columns + 1) // 2))
    return shapes


def most_levels(shape: tuple[int, int]) -> int:
    """Return how many times a plane can be split until one sample is left."""
    return (max(shape) - 1).bit_length()


def low_band_gain(shape: tuple[int, int], num_levels: int) -> float:
    """Return what a plane of ones is at the coarsest scale."""
    halvings = sum(size > 1 for shape_ in scale_shapes(shape, num_levels)[:-1] for size in shape_)
    return math.sqrt(2.0) ** halvings


@dataclass(frozen=True)
class Transform:
    """How planes become pyramids of coefficients, and back."""

    num_levels: int  # how many times planes are split
    wavelet: str = "9/7"  # one of `WAVELETS`
    edges: EdgeMaps | None = None  # of planes of their shape; by default none
    order: int = 0  # of the extrapolation at edges
    mask: Mask | None = None  # where there is anything, by default everywhere; its border is among the edges

    def __post_init__(self) -> None:
        if self.num_levels < 0:
            raise ValueError(f"`num_levels` must not be negative, got {self.num_levels}")
        if not 0 <= self.order <= MAX_ORDER:
            raise ValueError(f"`order` must be from 0 to {MAX_ORDER}, got {self.order}")

    def analyse(self, plane: ArrayLike) -> Pyramid:
        """Transform a plane, not across edges; the inverse of `synthesise`."""
        low, details = np.array(plane, np.float64, order="C"), []
        if low.ndim != 2 or low.size == 0:
            raise ValueError(f"`plane` must be two-dimensional and not empty, got shape {low.shape}")
        if self.edges is not None and low.shape != self.edges.shape:
            raise ValueError(f"`plane` must have the shape {self.edges.shape} of its edges, got {low.shape}")
        if self.mask is not None:
            low[~self.mask] = 0.0
        for level, maps in enumerate(self._scales(0)):
            self._split(low, None if maps is None else maps.between_rows)
            self._clear(low, level)
            across = np.ascontiguousarray(low.T)
            self._split(across, None if maps is None else maps.between_columns.T)
            self._clear(across.T, level)
            details.append(Details(across.T[0::2, 1::2], across.T[1::2, 0::2], across.T[1::2, 1::2]))
            low = np.ascontiguousarray(across.T[0::2, 0::2])
        return Pyramid(low, tuple(details))

    def synthesise(self, pyramid: Pyramid) -> Plane:
        """Return the plane of coefficients, or of those of coarse scales that of the finest one there is."""
        low, skipped = pyramid.low, self.num_levels - len(pyramid.details)
        scales = list(self._scales(skipped))
        for k, details in reversed(list(enumerate(pyramid.details))):
            (top, width), (bottom, right) = low.shape, details.diagonal.shape
            plane, maps = np.empty((top + bottom, width + right)), scales[k]
            number = max(_SAMPLES_AT_ONCE // (2 * plane.shape[1]), 1)
            for first in range(0, top, number):
                pairs, rows = slice(first, first + number), slice(2 * first, 2 * (first + number))
                across = np.empty(plane[rows].shape[::-1])
                across.T[0::2, 0::2], across.T[0::2, 1::2] = low[pairs], details.horizontal[pairs]
                across.T[1::2, 0::2], across.T[1::2, 1::2] = details.vertical[pairs], details.diagonal[pairs]
                self._merge(across, None if maps is None else maps.between_columns[rows].T)
                plane[rows] = across.T
            self._clear(plane, skipped + k)
            self._merge(plane, None if maps is None else maps.between_rows)
            self._clear(plane, skipped + k)
            low = plane
        return low

    def _scales(self, skipped: int) -> Iterator[EdgeMaps | None]:
        """Edges of scales that are split, the finest first."""
        if self.edges is None:
            return repeat(None, self.num_levels - skipped)
        return islice(self.edges.pyramid(self.num_levels), skipped, None)

    def _clear(self, plane: Plane, level: int) -> None:
        if self.mask is not None:
            plane[~self.mask[:: 2**level, :: 2**level]] = 0.0

    def _split(self, samples: Plane, edges: Flags | None) -> None:
        """Turn the columns of a plane into a low and a high band, in place, one row of each in turn."""
        if len(samples) > 1:
            self._lift(samples, edges, inverse=False)
            for band, scale in enumerate(WAVELETS[self.wavelet].scales):
                samples[band::2] *= scale

    def _merge(self, samples: Plane, edges: Flags | None) -> None:
        """Turn bands into the columns of a plane; the inverse of `_split`."""
        if len(samples) > 1:
            for band, scale in enumerate(WAVELETS[self.wavelet].scales):
                samples[band::2] /= scale
            self._lift(samples, edges, inverse=True)

    def _lift(self, samples: Plane, edges: Flags | None, *, inverse: bool) -> None:
        wavelet = WAVELETS[self.wavelet]
        weights: NDArray[np.float64] = np.array(wavelet.weights)
        flags = np.zeros(samples.shape, np.uint8) if edges is None else np.ascontiguousarray(edges)
        lift_columns(samples, flags, weights, wavelet.gain, self.order, inverse)


def mask_pyramid(mask: Mask, num_levels: int) -> Pyramid:
    """Return where coefficients of a masked plane exist."""
    low: Plane = (mask != 0).astype(np.float64)
    details = []
    for _ in range(num_levels):
        details.append(Details(low[0::2, 1::2], low[1::2, 0::2], low[1::2, 1::2]))
        low = low[0::2, 0::2]
    return Pyramid(low, tuple(details))
