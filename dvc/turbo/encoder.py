"""Turbo encoding of all bit planes of a frame together, one machine word per bit position."""

import numpy as np
from numpy.typing import NDArray

from dvc.turbo import _kernels
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


def encode_words(words: NDArray[np.uint64], code: TurboCode, interleaver_seed: int) -> NDArray[np.uint64]:
    """Return the parity of up to 64 bit planes at once, one machine word per bit position.

    Parameters
    ----------
    words : ndarray of shape (N,), uint64
        Bit p of word n is bit n of plane p.
    code : TurboCode
        The code.
    interleaver_seed : int
        Seed that encoder and decoder share.

    Returns
    -------
    ndarray of shape (N,), uint64
        Bit p of word m is the m-th parity bit that is released of plane p.
    """
    layout = copy_layout(code, words.size, interleaver_seed)
    starts = np.array(layout.section_starts, np.int64)
    parity = np.empty(layout.num_steps, np.uint64)
    _kernels.encode_words(words, layout.bit_at_step, starts, code.feedback, code.feedforward, parity)
    return parity[release_order(code, words.size)]


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
    check_planes(bits)
    num_planes, num_bits = bits.shape
    parity = np.empty((num_planes, num_bits), np.uint8)
    words = np.empty(num_bits, np.uint64)
    positions = np.arange(num_bits, dtype=np.int32)
    for first in range(0, num_planes, 64):
        group = slice(first, min(first + 64, num_planes))
        _kernels.pack_words(bits[group], words)
        _kernels.gather_bits(encode_words(words, code, interleaver_seed), positions, parity[group])
    return parity
