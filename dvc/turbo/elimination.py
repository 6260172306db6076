"""Solving the parity equations of a plane over GF(2), where iterations do not get there."""

import numpy as np
from numpy.typing import NDArray

from dvc.turbo.codes import TurboCode
from dvc.turbo.crc import POLYNOMIALS
from dvc.turbo.interleaver import copy_layout
from dvc.turbo.puncturing import release_order


def parity_equations(code: TurboCode, num_bits: int, seed: int, num_parity: int) -> NDArray[np.uint64]:
    """Write the first parity bits in order of release as linear equations of the plane's bits.

    Parameters
    ----------
    code : TurboCode
        The code.
    num_bits, seed : int
        Length N of the plane and interleaver seed.
    num_parity : int
        Number of equations.

    Returns
    -------
    ndarray of shape (num_parity, ceil(N / 64)), uint64
        Bit ``n % 64`` of word ``n // 64`` is the weight of bit n.
    """
    from dvc.turbo import _kernels

    layout = copy_layout(code, num_bits, seed)
    row_of_step = np.full(layout.num_steps, -1, np.int32)
    row_of_step[release_order(code, num_bits)[:num_parity]] = np.arange(num_parity)
    rows = np.zeros((num_parity, -(-num_bits // 64)), np.uint64)
    starts = np.array(layout.section_starts, np.int64)
    _kernels.parity_rows(layout.bit_at_step, starts, code.feedback, code.feedforward, row_of_step, rows)
    return rows


def crc_equations(num_bits: int, crc_bits: int) -> NDArray[np.uint64]:
    """Write the check bits of a plane as linear equations of its bits.

    Parameters
    ----------
    num_bits : int
        Length N of the plane.
    crc_bits : int
        Number of check bits, as for `dvc.turbo.crc`.

    Returns
    -------
    ndarray of shape (crc_bits, ceil(N / 64)), uint64
        Bit ``n % 64`` of word ``n // 64`` is the weight of bit n.
    """
    polynomial, top = POLYNOMIALS[crc_bits], 1 << (crc_bits - 1)
    mask = (1 << crc_bits) - 1
    rows = np.zeros((crc_bits, -(-num_bits // 64)), np.uint64)
    register = polynomial  # remainder of x**crc_bits: the weight of the plane's last bit
    for n in range(num_bits - 1, -1, -1):
        for row in range(crc_bits):
            if register >> (crc_bits - 1 - row) & 1:
                rows[row, n >> 6] |= np.uint64(1 << (n & 63))
        register = ((register << 1) & mask) ^ (polynomial if register & top else 0)
    return rows


def solve(
    rows: NDArray[np.uint64], values: NDArray[np.uint8], llr: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], int] | None:
    """Solve linear equations over GF(2), taking free bits from their LLRs.

    The least reliable bits are solved for; what stays free are the most reliable ones (ordered statistics
    decoding of order 0).

    Parameters
    ----------
    rows : ndarray of shape (M, ceil(N / 64)), uint64
        Equations; overwritten.
    values : ndarray of shape (M,), uint8
        Right-hand sides.
    llr : ndarray of shape (N,), float32
        LLR log p(0) / p(1) of every bit.

    Returns
    -------
    tuple of (ndarray of shape (N,) uint8, int), or None
        The solution and the number of free bits; None where the equations contradict each other.
    """
    from dvc.turbo import _kernels

    num_bits = llr.size
    column_order = np.argsort(np.abs(llr), kind="stable")
    pivot_row = np.empty(num_bits, np.int64)
    rhs = values.astype(np.uint8).copy()
    rank = _kernels.eliminate(rows, rhs, column_order, pivot_row)
    if rank < 0:
        return None
    free = pivot_row < 0
    bits = np.where(free, llr < 0, 0).astype(np.uint8)
    packed = np.zeros(rows.shape[1] * 64, np.uint8)
    packed[:num_bits] = bits
    words = np.packbits(packed, bitorder="little").view("<u8").astype(np.uint64)
    pivots = np.flatnonzero(~free)
    known = np.bitwise_count(rows[pivot_row[pivots]] & words).sum(axis=1) & 1
    bits[pivots] = rhs[pivot_row[pivots]] ^ known.astype(np.uint8)
    return bits, int(free.sum())
