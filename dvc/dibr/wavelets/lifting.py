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
    """Weights of the lifting steps.

    Attributes
    ----------
    name : str
        As given on command lines.
    weights : tuple of float
        Of steps that change the odd and the even samples, in turn; (4.1), (4.2).
    gain : float
        Of the low band for constant signals, before scaling.
    """

    name: str
    weights: tuple[float, ...]
    gain: float

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
    """High bands of one scale.

    Attributes
    ----------
    horizontal : ndarray of shape (ceil(H / 2), W // 2), float64
        High-pass along rows, low-pass along columns.
    vertical : ndarray of shape (H // 2, ceil(W / 2)), float64
        The other way round.
    diagonal : ndarray of shape (H // 2, W // 2), float64
        High-pass along both. H and W are the size of the plane that was split.
    """

    horizontal: Plane
    vertical: Plane
    diagonal: Plane

    @property
    def bands(self) -> tuple[Plane, Plane, Plane]:
        """The three of them in this order."""
        return self.horizontal, self.vertical, self.diagonal


@dataclass(frozen=True)
class Pyramid:
    """Coefficients of a plane.

    Attributes
    ----------
    low : ndarray of shape (h, w), float64
        What is left of the plane at the coarsest scale.
    details : tuple of Details
        High bands, the finest scale first.
    """

    low: Plane
    details: tuple[Details, ...]


def scale_shapes(shape: tuple[int, int], num_levels: int) -> list[tuple[int, int]]:
    """Return the sizes of a plane at all scales.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the plane.
    num_levels : int
        How many times it is split.

    Returns
    -------
    list of tuple of int
        From the plane itself to the coarsest low band; ``num_levels + 1`` of them.
    """
    shapes = [shape]
    for _ in range(num_levels):
        rows, columns = shapes[-1]
        shapes.append(((rows + 1) // 2, (columns + 1) // 2))
    return shapes


def most_levels(shape: tuple[int, int]) -> int:
    """Return how many times a plane can be split until one sample is left.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.

    Returns
    -------
    int
        ``ceil(log2(max(shape)))``.
    """
    return (max(shape) - 1).bit_length()


def analyse(plane: ArrayLike, num_levels: int, wavelet: Wavelet = WAVELETS["9/7"]) -> Pyramid:
    """Transform a plane; the inverse of `synthesise`.

    Parameters
    ----------
    plane : array_like of shape (H, W)
        Samples.
    num_levels : int
        How many times the low band is split; sizes of 1 are left as they are.
    wavelet : Wavelet, optional
        The 9/7 by default.

    Returns
    -------
    Pyramid
        Its coefficients.

    Raises
    ------
    ValueError
        If the plane is empty or not two-dimensional, or the number of levels negative.

    References
    ----------
    [Maitre2008] Eqs. (3.9), (4.1), (4.2).
    """
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
    """Return the plane of some coefficients; the inverse of `analyse`.

    Parameters
    ----------
    pyramid : Pyramid
        Coefficients; without its finest details it gives the low band of that scale.
    wavelet : Wavelet, optional
        The 9/7 by default.

    Returns
    -------
    ndarray of shape (H, W), float64
        The plane.
    """
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
    """Return what a plane of ones is at the coarsest scale.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the plane.
    num_levels : int
        How many times it is split.

    Returns
    -------
    float
        The root of two for each time that rows or columns are halved.
    """
    halvings = sum(size > 1 for shape_ in scale_shapes(shape, num_levels)[:-1] for size in shape_)
    return math.sqrt(2.0) ** halvings


def split(samples: Plane, wavelet: Wavelet) -> tuple[Plane, Plane]:
    """Split the columns of a plane into a low and a high band.

    Parameters
    ----------
    samples : ndarray of shape (n, W), float64
        Columns of n samples, at least one; a single one is left as it is.
    wavelet : Wavelet
        Which.

    Returns
    -------
    low : ndarray of shape (ceil(n / 2), W), float64
        Low band.
    high : ndarray of shape (n // 2, W), float64
        High band.
    """
    even, odd = samples[0::2].copy(), samples[1::2].copy()
    if not len(odd):
        return even, odd
    for step, weight in enumerate(wavelet.weights):
        _lift(even, odd, step, weight)
    low, high = wavelet.scales
    return even * low, odd * high


def merge(low: Plane, high: Plane, wavelet: Wavelet) -> Plane:
    """Merge a low and a high band; the inverse of `split`.

    Parameters
    ----------
    low : ndarray of shape (ceil(n / 2), W), float64
        Low band.
    high : ndarray of shape (n // 2, W), float64
        High band.
    wavelet : Wavelet
        Which.

    Returns
    -------
    ndarray of shape (n, W), float64
        The samples.
    """
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
