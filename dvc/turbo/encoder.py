"""Turbo encoding of all bit planes of a frame together, one machine word per bit position."""

import numpy as np
from numpy.typing import NDArray

from dvc.turbo.codes import TurboCode
from dvc.turbo.interleaver import copy_layout
from dvc.turbo.puncturing import release_order


def check_planes(bits: NDArray[np.uint8]) -> None:
    """Refuse anything but bit planes.

    Parameters
    ----------
    bits : ndarray of shape (P, N), uint8
        Planes, each element 0 or 1.

    Raises
    ------
    TypeError
        If the elements are not uint8.
    ValueError
        If the shape or a value is wrong.
    """
    if not isinstance(bits, np.ndarray) or bits.dtype != np.uint8:
        raise TypeError(f"`bits` must be an array of uint8, got {getattr(bits, 'dtype', type(bits))}")
    if bits.ndim != 2 or bits.shape[1] < 1:
        raise ValueError(f"`bits` must have shape (planes, bits >= 1), got {bits.shape}")
    if bits.size and bits.max() > 1:
        raise ValueError(f"`bits` must hold 0 and 1 only, got {bits.max()}")


def encode_planes(bits: NDArray[np.uint8], code: TurboCode, interleaver_seed: int) -> NDArray[np.uint8]:
    """Return the parity of bit planes in order of release.

    Parameters
    ----------
    bits : ndarray of shape (P, N), uint8
        Planes, each element 0 or 1.
    code : TurboCode
        The code.
    interleaver_seed : int
        Seed that encoder and decoder share.

    Returns
    -------
    ndarray of shape (P, N), uint8
        Column m is the m-th parity bit that is released.

    Raises
    ------
    TypeError, ValueError
        If `bits` are not planes of bits.
    """
    from dvc.turbo import _kernels

    check_planes(bits)
    num_planes, num_bits = bits.shape
    layout = copy_layout(code, num_bits, interleaver_seed)
    order = release_order(code, num_bits)
    starts = np.array(layout.section_starts, np.int64)
    parity = np.empty((num_planes, order.size), np.uint8)
    words = np.empty(num_bits, np.uint64)
    parity_words = np.empty(layout.num_steps, np.uint64)
    for first in range(0, num_planes, 64):
        group = slice(first, min(first + 64, num_planes))
        _kernels.pack_words(bits[group], words)
        _kernels.encode_words(
            words, layout.bit_at_step, starts, code.feedback, code.feedforward, parity_words
        )
        _kernels.gather_bits(parity_words, order, parity[group])
    return parity
