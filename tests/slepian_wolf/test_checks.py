"""Tests of the cyclic redundancy check."""

import numpy as np
import pytest

from dvc.slepian_wolf import _kernels, crc
from dvc.slepian_wolf.checks import POLYNOMIALS
from tests.reference.slepian_wolf import crc_remainder
from tests.twins import Choose


@pytest.mark.nojit
@pytest.mark.parametrize(("num_bits", "check"), [(16, 0x31C3), (8, 0xF4)])
def test_published_check_values(num_bits: int, check: int) -> None:
    """The bytes 123456789 give the published values of CRC-16/XMODEM and CRC-8/SMBUS."""
    bits = np.unpackbits(np.frombuffer(b"123456789", np.uint8))
    assert int("".join(map(str, crc(bits, num_bits))), 2) == check


@pytest.mark.nojit
@pytest.mark.parametrize("width", sorted(POLYNOMIALS))
def test_kernel_divides_planes_of_any_length(width: int, choose: Choose) -> None:
    run = choose(_kernels.crc_words)
    rng = np.random.default_rng(width)
    for length in (1, 3 * width - 1, 15 * width, 63 * width, 64 * width + 1, 150 * width):
        words, checks = rng.integers(0, 2**64, length, dtype=np.uint64), np.empty(width, np.uint64)
        run(words, POLYNOMIALS[width], width, checks)
        for plane in (0, 41, 63):
            bits, got = ((w >> np.uint64(plane)).astype(np.uint8) & 1 for w in (words, checks))
            np.testing.assert_array_equal(got, crc_remainder(bits, POLYNOMIALS[width], width))


def test_keeps_leading_dimensions() -> None:
    planes = np.random.default_rng(0).integers(0, 2, (3, 30, 17), dtype=np.uint8)
    checks = crc(planes, 8)
    assert checks.shape == (3, 30, 8)
    np.testing.assert_array_equal(checks[2, 29], crc(planes[2, 29], 8))
    with pytest.raises(ValueError, match="one of"):
        crc(np.zeros(9, np.uint8), 7)
