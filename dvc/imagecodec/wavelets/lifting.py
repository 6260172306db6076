"""Lifting: the 9/7 and 5/3 wavelet transforms of planes of any size, scaled to be near-orthonormal.

Even samples become the low band, odd ones the high band. Each step changes one of the two cosets by the sum
of the neighbours in the other, so the same steps backward, with opposite signs, are the inverse whatever the
neighbours beyond a border are taken to be. Here they are those of the symmetric extension about the last
sample.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Plane = NDArray[np.float64]

_BLOCK_SAMPLES = 2**16  # that are merged at a time


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


def analyse(plane: ArrayLike, num_levels: int, wavelet: Wavelet = WAVELETS["9/7"]) -> Pyramid:
    """Transform a plane; the inverse of `synthesise`."""
    low = np.array(plane, np.float64)
    if low.ndim != 2 or low.size == 0:
        raise ValueError(f"`plane` must be two-dimensional and not empty, got shape {low.shape}")
    if num_levels < 0:
        raise ValueError(f"`num_levels` must not be negative, got {num_levels}")
    details = []
    for _ in range(num_levels):
        top, bottom = split(low, wavelet)
        low, horizontal = (half.T for half in split(top.T, wavelet))
        vertical, diagonal = (half.T for half in split(bottom.T, wavelet))
        details.append(Details(horizontal, vertical, diagonal))
    return Pyramid(low, tuple(details))


def synthesise(pyramid: Pyramid, wavelet: Wavelet = WAVELETS["9/7"]) -> Plane:
    """Return the plane of some coefficients; the inverse of `analyse`."""
    low = pyramid.low
    for details in reversed(pyramid.details):
        plane = np.empty((len(low) + len(details.vertical), low.shape[1] + details.horizontal.shape[1]))
        top, bottom = plane[0::2], plane[1::2]
        _merge_into(top.T, low.T, details.horizontal.T, wavelet)
        _merge_into(bottom.T, details.vertical.T, details.diagonal.T, wavelet)
        _merge_into(plane, top, bottom, wavelet)
        low = plane
    return low


def low_band_gain(shape: tuple[int, int], num_levels: int) -> float:
    """Return what a plane of ones is at the coarsest scale."""
    halvings = sum(size > 1 for shape_ in scale_shapes(shape, num_levels)[:-1] for size in shape_)
    return math.sqrt(2.0) ** halvings


def split(samples: Plane, wavelet: Wavelet) -> tuple[Plane, Plane]:
    """Split the columns of a plane into a low and a high band."""
    even, odd = samples[0::2].copy(), samples[1::2].copy()
    if not len(odd):
        return even, odd
    for step, weight in enumerate(wavelet.weights):
        _lift(even, odd, step, weight)
    low, high = wavelet.scales
    return even * low, odd * high


def merge(low: Plane, high: Plane, wavelet: Wavelet) -> Plane:
    """Merge a low and a high band; the inverse of `split`."""
    samples = np.empty((len(low) + len(high), low.shape[1]))
    _merge_into(samples, low, high, wavelet)
    return samples


def _merge_into(samples: Plane, low: Plane, high: Plane, wavelet: Wavelet) -> None:
    """Merge bands, which may lie in the same place, some columns at a time."""
    if not len(high):
        samples[:] = low
        return
    scales = wavelet.scales
    width = max(_BLOCK_SAMPLES // len(samples), 1)
    for start in range(0, low.shape[1], width):
        columns = slice(start, start + width)
        even, odd = low[:, columns] / scales[0], high[:, columns] / scales[1]
        for step in reversed(range(len(wavelet.weights))):
            _lift(even, odd, step, -wavelet.weights[step])
        samples[0::2, columns], samples[1::2, columns] = even, odd


def _lift(even: Plane, odd: Plane, step: int, weight: float) -> None:
    """Change the odd samples (4.1) or, in every other step, the even ones (4.2), in place."""
    if step % 2 == 0:
        after = np.concatenate([even[1:], even[-1:]])[: len(odd)]  # beyond the end: the last but one
        odd += weight * (even[: len(odd)] + after)
    else:
        before = np.concatenate([odd[:1], odd])[: len(even)]
        after = np.concatenate([odd, odd[-1:]])[: len(even)]
        even += weight * (before + after)
