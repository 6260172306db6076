"""Tests of the bit-sliced encoder."""

import numpy as np
import pytest

from dvc.slepian_wolf import crc, crc_words
from dvc.slepian_wolf.turbo.codes import CLASSICAL
from dvc.slepian_wolf.turbo.encoder import encode_planes, encode_words
from dvc.slepian_wolf.turbo.interleaver import interleaved
from dvc.slepian_wolf.turbo.puncturing import release_order
from tests.reference.turbo_bcjr import rsc_encode


@pytest.mark.parametrize("num_bits", [1, 2, 7, 50, 201])
def test_parity_is_that_of_the_plain_encoder(num_bits: int) -> None:
    """Each section of the trellis carries the quotient of polynomials, in order of release."""
    planes = np.random.default_rng(num_bits).integers(0, 2, (70, num_bits), dtype=np.uint8)
    bits = interleaved(num_bits, 5)
    parity = encode_planes(planes, CLASSICAL, 5)
    for plane in (0, 63, 64, 69):
        sections = [
            rsc_encode(planes[plane, part], CLASSICAL.feedback, CLASSICAL.feedforward)
            for part in (bits[:num_bits], bits[num_bits:])
        ]
        released = np.concatenate(sections)[release_order(num_bits, CLASSICAL.period)]
        np.testing.assert_array_equal(parity[plane], released)


@pytest.mark.nojit
def test_words_hold_the_same_bits() -> None:
    """Packed words give the parity and check bits of the planes that they hold."""
    planes = np.random.default_rng(2).integers(0, 2, (64, 90), dtype=np.uint8)
    words = (planes.astype(np.uint64) << np.arange(64, dtype=np.uint64)[:, None]).sum(axis=0, dtype=np.uint64)
    for packed, plain in (
        (encode_words(words, CLASSICAL, 1), encode_planes(planes, CLASSICAL, 1)),
        (crc_words(words, 16), crc(planes, 16)),
    ):
        np.testing.assert_array_equal((packed >> np.uint64(63)) & np.uint64(1), plain[63])
        np.testing.assert_array_equal(packed & np.uint64(1), plain[0])


def test_no_planes_give_no_parity() -> None:
    """A frame without planes is coded into nothing."""
    assert encode_planes(np.zeros((0, 20), np.uint8), CLASSICAL, 1).shape == (0, 20)


def test_refuses_what_is_no_plane() -> None:
    """Other types, shapes and values than bits are refused."""
    with pytest.raises(TypeError, match="uint8"):
        encode_planes(np.zeros((1, 5)), CLASSICAL, 1)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="shape"):
        encode_planes(np.zeros(5, np.uint8), CLASSICAL, 1)
    with pytest.raises(ValueError, match="0 and 1"):
        encode_planes(np.full((1, 5), 2, np.uint8), CLASSICAL, 1)
