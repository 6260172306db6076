"""Shape-adaptive lifting: wavelets that stop at edges.

What a step would take from beyond an edge is extrapolated from the samples of the same coset on this side
by a polynomial (4.4), so the inverse knows it too. With too few of them the polynomial has a lower degree.
In the last step details beyond an edge are taken to be zero, as if the polynomial fitted there; not so with
degree 0, which is the symmetric extension of shape-adaptive transforms. A sample of the low band that is
alone between edges is scaled as a constant is; one of the high band is predicted from beyond its edges.
Borders of the plane are symmetric, so that without edges this is `dvc.imagecodec.wavelets.lifting`.

With a mask, whose border is among the edges, there is nothing outside it: samples and coefficients there are
zero after each step, so that what is inside does not depend on them.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.imagecodec.wavelets.column_lifting import lift_columns
from dvc.imagecodec.wavelets.edge_maps import EdgeMaps, Flags
from dvc.imagecodec.wavelets.lifting import WAVELETS, Details, Plane, Pyramid, Wavelet

MAX_ORDER = 3
"""Highest degree of the polynomials."""


Mask = NDArray[np.bool_]


def analyse(
    plane: ArrayLike,
    edges: EdgeMaps,
    num_levels: int,
    order: int,
    wavelet: Wavelet = WAVELETS["9/7"],
    mask: Mask | None = None,
) -> Pyramid:
    """Transform a plane, not across edges; the inverse of `synthesise`."""
    low = np.array(plane, np.float64)
    if low.shape != edges.shape or low.size == 0:
        raise ValueError(f"`plane` must have the shape {edges.shape} of its edges, got {low.shape}")
    if num_levels < 0:
        raise ValueError(f"`num_levels` must not be negative, got {num_levels}")
    if not 0 <= order <= MAX_ORDER:
        raise ValueError(f"`order` must be from 0 to {MAX_ORDER}, got {order}")
    inside = None if mask is None else mask != 0
    low = _kept(low, inside)
    details = []
    for maps in edges.pyramid(num_levels):
        top, bottom = split(low, maps.between_rows, order, wavelet)
        upper, lower = (None, None) if inside is None else (inside[0::2], inside[1::2])
        top, bottom = _kept(top, upper), _kept(bottom, lower)
        low, horizontal = (half.T for half in split(top.T, maps.between_columns[0::2].T, order, wavelet))
        vertical, diagonal = (
            half.T for half in split(bottom.T, maps.between_columns[1::2].T, order, wavelet)
        )
        if upper is not None and lower is not None:
            low, horizontal = _kept(low, upper[:, 0::2]), _kept(horizontal, upper[:, 1::2])
            vertical, diagonal = _kept(vertical, lower[:, 0::2]), _kept(diagonal, lower[:, 1::2])
            inside = upper[:, 0::2]
        details.append(Details(horizontal, vertical, diagonal))
    return Pyramid(low, tuple(details))


def mask_pyramid(mask: Mask, num_levels: int) -> Pyramid:
    """Return where coefficients of a masked plane exist."""
    low: Plane = (mask != 0).astype(np.float64)
    details = []
    for _ in range(num_levels):
        details.append(Details(low[0::2, 1::2], low[1::2, 0::2], low[1::2, 1::2]))
        low = low[0::2, 0::2]
    return Pyramid(low, tuple(details))


def synthesise(
    pyramid: Pyramid,
    edges: EdgeMaps,
    order: int,
    wavelet: Wavelet = WAVELETS["9/7"],
    mask: Mask | None = None,
) -> Plane:
    """Return the plane of some coefficients; the inverse of `analyse`."""
    low = pyramid.low
    num_levels = len(pyramid.details)
    scales = list(edges.pyramid(num_levels))
    for level in reversed(range(num_levels)):
        details, maps = pyramid.details[level], scales[level]
        inside = None if mask is None else mask[:: 2**level, :: 2**level]
        columns, plane = maps.between_columns, np.empty(maps.shape)
        plane[0::2] = merge(low.T, details.horizontal.T, columns[0::2].T, order, wavelet).T
        plane[1::2] = merge(details.vertical.T, details.diagonal.T, columns[1::2].T, order, wavelet).T
        _clear_outside(plane, inside)
        _unlift(plane, maps.between_rows, order, wavelet)
        _clear_outside(plane, inside)
        low = plane
    return low


def split(samples: Plane, edges: Flags, order: int, wavelet: Wavelet) -> tuple[Plane, Plane]:
    """Split the columns of a plane into a low and a high band."""
    lifted = np.array(samples, np.float64, order="C")
    if len(lifted) < 2:
        return lifted[:1], lifted[1:]
    _lift(lifted, edges, order, wavelet, inverse=False)
    low, high = wavelet.scales
    return lifted[0::2] * low, lifted[1::2] * high


def merge(low: Plane, high: Plane, edges: Flags, order: int, wavelet: Wavelet) -> Plane:
    """Merge a low and a high band; the inverse of `split`."""
    samples = np.empty((len(low) + len(high), low.shape[1]))
    samples[0::2], samples[1::2] = low, high
    _unlift(samples, edges, order, wavelet)
    return samples


def _unlift(samples: Plane, edges: Flags, order: int, wavelet: Wavelet) -> None:
    """Undo the lifting of columns of alternating low and high bands in place."""
    if len(samples) < 2:
        return
    scales = wavelet.scales
    samples[0::2] /= scales[0]
    samples[1::2] /= scales[1]
    _lift(samples, edges, order, wavelet, inverse=True)


def _clear_outside(samples: Plane, inside: Mask | None) -> None:
    if inside is not None:
        samples[~inside] = 0.0


def _kept(samples: Plane, inside: Mask | None) -> Plane:
    """Samples with zeros outside a mask, if there is one."""
    return samples if inside is None else np.where(inside, samples, 0.0)


def _lift(samples: Plane, edges: Flags, order: int, wavelet: Wavelet, *, inverse: bool) -> None:
    weights: NDArray[np.float64] = np.array(wavelet.weights)
    lift_columns(samples, np.ascontiguousarray(edges), weights, wavelet.gain, order, inverse)
