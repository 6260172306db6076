"""Lifting: the 9/7 and 5/3 wavelet transforms of planes of any size; they may stop at edges.

Even samples become the low band, odd ones the high band. Each step changes one coset by neighbours in the
other, so the same steps backward, with opposite signs, are the inverse for any extension at a border.
Samples beyond an edge are extrapolated from those of their coset on this side by a polynomial (4.4), of a
lower degree if they are too few. In the last step, except with degree 0 (the symmetric extension of
shape-adaptive transforms), details beyond an edge are taken to be zero. A sample of the low band isolated
between edges is scaled as a constant is; one of the high band is predicted from beyond its edges. The border
of a mask is among the edges; samples and coefficients outside are zero after each step.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, repeat
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dvc._jit import kernel
from dvc.arrays import Floats, Mask
from dvc.images.edge_maps import EdgeMaps, Flags

Plane = Floats

EXTRAPOLATION = np.array(
    [[1.0, 0.0, 0.0, 0.0], [2.0, -1.0, 0.0, 0.0], [3.0, -3.0, 1.0, 0.0], [4.0, -6.0, 4.0, -1.0]]
)
"""Weights of (4.4) for polynomials of degrees 0 to 3."""

_SAMPLES_AT_ONCE = 2**17  # samples of rows that are merged at once: planes may be large
_BEFORE, _AFTER = np.array([-1, 1])  # no literals, for each of which numba compiles
FORWARD: Any = np.bool_(False)
MAX_ORDER = 3
"""Highest degree of the polynomials."""


@dataclass(frozen=True)
class Wavelet:
    """Weights of the lifting steps."""

    weights: tuple[float, ...]  # weights of steps that change odd and even samples, in turn; (4.1), (4.2)
    gain: float  # gain of the low band for constant signals, before scaling

    @property
    def scales(self) -> tuple[float, float]:
        """Factors of the low and the high band that make the transform near-orthonormal (3.9)."""
        return math.sqrt(2.0) / self.gain, self.gain / math.sqrt(2.0)


WAVELETS = {
    "9/7": Wavelet(
        (-1.586134342059924, -0.052980118572961, 0.882911075530934, 0.443506852043971), 1.230174104914001
    ),
    "5/3": Wavelet((-0.5, 0.25), 1.0),
}


class Details(NamedTuple):
    """High bands of one scale."""

    horizontal: Plane  # high-pass along rows, low-pass along columns
    vertical: Plane  # the other way round
    diagonal: Plane  # high-pass along both


@dataclass(frozen=True)
class Pyramid:
    """Coefficients of a plane."""

    low: Plane  # low band of the coarsest scale
    details: tuple[Details, ...]  # high bands, the finest scale first


def scale_shapes(shape: tuple[int, int], num_levels: int) -> list[tuple[int, int]]:
    """Return the sizes of a plane at all scales."""
    shapes = [shape]
    for _ in range(num_levels):
        rows, columns = shapes[-1]
        shapes.append(((rows + 1) // 2, (columns + 1) // 2))
    return shapes


def most_levels(shape: tuple[int, int]) -> int:
    """Return the number of splits of a plane down to one sample."""
    return (max(shape) - 1).bit_length()


def low_band_gain(shape: tuple[int, int], num_levels: int) -> float:
    """Return the value of a plane of ones at the coarsest scale."""
    halvings = sum(size > 1 for shape_ in scale_shapes(shape, num_levels)[:-1] for size in shape_)
    return math.sqrt(2.0) ** halvings


@dataclass(frozen=True)
class Transform:
    """Transform of planes to pyramids of coefficients, and back."""

    num_levels: int  # number of splits
    wavelet: str = "9/7"  # one of `WAVELETS`
    edges: EdgeMaps | None = None  # edges of planes of their shape
    order: int = 0  # order of the extrapolation at edges
    mask: Mask | None = None  # by default everything; its border is among the edges

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
            self._lift(low, None if maps is None else maps.between_rows)
            self._clear(low, level)
            across = np.ascontiguousarray(low.T)
            self._lift(across, None if maps is None else maps.between_columns.T)
            self._clear(across.T, level)
            details.append(Details(across.T[0::2, 1::2], across.T[1::2, 0::2], across.T[1::2, 1::2]))
            low = np.ascontiguousarray(across.T[0::2, 0::2])
        return Pyramid(low, tuple(details))

    def synthesise(self, pyramid: Pyramid) -> Plane:
        """Return the plane of coefficients, of the finest scale among them."""
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
                self._lift(across, None if maps is None else maps.between_columns[rows].T, inverse=True)
                plane[rows] = across.T
            self._clear(plane, skipped + k)
            self._lift(plane, None if maps is None else maps.between_rows, inverse=True)
            self._clear(plane, skipped + k)
            low = plane
        return low

    def _scales(self, skipped: int) -> Iterator[EdgeMaps | None]:
        """Return the edges of scales that are split, the finest first."""
        if self.edges is None:
            return repeat(None, self.num_levels - skipped)
        return islice(self.edges.pyramid(self.num_levels), skipped, None)

    def _clear(self, plane: Plane, level: int) -> None:
        if self.mask is not None:
            plane[~self.mask[:: 2**level, :: 2**level]] = 0.0

    def _lift(self, samples: Plane, edges: Flags | None, *, inverse: bool = False) -> None:
        """Turn the columns of a plane into a low and a high band in place, a row of each in turn; or back."""
        if len(samples) < 2:
            return
        wavelet = WAVELETS[self.wavelet]
        flags = np.zeros(samples.shape, np.uint8) if edges is None else np.ascontiguousarray(edges)
        for band, scale in enumerate(wavelet.scales if inverse else ()):
            samples[band::2] /= scale
        lift_columns(samples, flags, np.array(wavelet.weights), wavelet.gain, self.order, inverse)
        for band, scale in enumerate(() if inverse else wavelet.scales):
            samples[band::2] *= scale


def mask_pyramid(mask: Mask, num_levels: int) -> Pyramid:
    """Return the mask of coefficients of a masked plane."""
    low: Plane = (mask != 0).astype(np.float64)
    details = []
    for _ in range(num_levels):
        details.append(Details(low[0::2, 1::2], low[1::2, 0::2], low[1::2, 1::2]))
        low = low[0::2, 0::2]
    return Pyramid(low, tuple(details))


@kernel
def lift_columns(
    samples: Plane, edges: Flags, weights: Plane, gain: float, order: int, inverse: bool
) -> None:
    """Apply the lifting steps of a wavelet to columns in place, (4.1) and (4.2), not across edges."""
    num_steps = len(weights)
    for k in range(num_steps):
        step = num_steps - 1 - k if inverse else k
        weight = -weights[step] if inverse else weights[step]
        final = order > 0 and step == num_steps - 1 and step % 2 == 1
        _change(samples, edges, 1 - step % 2, weight, order, final)
        if step == 1:
            _scale_lone(samples, edges, 1.0 / gain if inverse else gain)


@kernel
def _change(samples: Plane, edges: Flags, first: int, weight: float, order: int, final: bool) -> None:
    """Change odd or even samples; with `final`, details beyond an edge are taken to be zero.

    If a sample is isolated between edges, an odd one is predicted from beyond them, an even one stays.
    """
    num_rows, num_columns = samples.shape
    last = num_rows - 1
    for i in range(first, num_rows, 2):
        for t in range(num_columns):
            cut_before = i > 0 and edges[i - 1, t] != 0
            cut_after = i < last and edges[i, t] != 0
            if (cut_before or i == 0) and (cut_after or i == last):
                if first == 0:
                    continue
                cut_before = cut_after = False
            before, after = 0.0, 0.0
            if i == 0:
                before = samples[i + 1, t]
            elif not cut_before:
                before = samples[i - 1, t]
            elif not final:
                before = _beyond(samples, edges, i, t, _BEFORE, order)
            if i == last:
                after = samples[i - 1, t]
            elif not cut_after:
                after = samples[i + 1, t]
            elif not final:
                after = _beyond(samples, edges, i, t, _AFTER, order)
            samples[i, t] += weight * (before + after)


@kernel
def _scale_lone(samples: Plane, edges: Flags, factor: float) -> None:
    """Scale even samples that are isolated between edges as constant signals are."""
    num_rows, num_columns = samples.shape
    last = num_rows - 1
    for i in range(0, num_rows, 2):
        for t in range(num_columns):
            if (i == 0 or edges[i - 1, t] != 0) and (i == last or edges[i, t] != 0):
                samples[i, t] *= factor


@kernel
def _beyond(samples: Plane, edges: Flags, i: int, t: int, way: int, order: int) -> float:
    """Extrapolate the sample beyond the edge next to sample i from those of its coset on this side (4.4)."""
    num_rows = samples.shape[0]
    available = 0
    k = i
    while available <= order:
        k -= way
        if k < 0 or k >= num_rows or edges[min(k, k + way), t] != 0:
            break
        if (i - k) % 2 != 0:
            available += 1
    total = 0.0
    for m in range(available):
        total += EXTRAPOLATION[available - 1, m] * samples[i - way * (2 * m + 1), t]
    return float(total)
