"""Tests of the bit-sliced encoder."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.slepian_wolf import crc, crc_words
from dvc.slepian_wolf.checks import random_keys, random_permutation
from dvc.slepian_wolf.turbo.turbo_encoder import (
    FEEDBACK,
    FEEDFORWARD,
    PERIOD,
    interleaved,
    release_order,
    trellis,
)
from tests.coders import encode_planes
from tests.reference.slepian_wolf import rsc_encode


@pytest.mark.parametrize("num_bits", [1, 2, 7, 50, 201])
def test_parity_is_that_of_the_plain_encoder(num_bits: int) -> None:
    """Each section of the trellis carries the quotient of polynomials, in order of release."""
    planes = np.random.default_rng(num_bits).integers(0, 2, (70, num_bits), dtype=np.uint8)
    bits = interleaved(num_bits, 5)
    parity = encode_planes(planes, 5)
    for plane in (0, 63, 64, 69):
        sections = [
            rsc_encode(planes[plane, part], FEEDBACK, FEEDFORWARD)
            for part in (bits[:num_bits], bits[num_bits:])
        ]
        released = np.concatenate(sections)[release_order(num_bits, PERIOD)]
        np.testing.assert_array_equal(parity[plane], released)


@pytest.mark.nojit
def test_words_hold_the_same_bits() -> None:
    planes = np.random.default_rng(2).integers(0, 2, (64, 90), dtype=np.uint8)
    words = (planes.astype(np.uint64) << np.arange(64, dtype=np.uint64)[:, None]).sum(axis=0, dtype=np.uint64)
    packed, plain = crc_words(words, 16), crc(planes, 16)
    np.testing.assert_array_equal((packed >> np.uint64(63)) & np.uint64(1), plain[63])
    np.testing.assert_array_equal(packed & np.uint64(1), plain[0])


def test_refuses_what_is_no_plane() -> None:
    """Other types, shapes and values than bits are refused; a frame without planes has no checks."""
    assert crc(np.zeros((0, 20), np.uint8), 16).shape == (0, 16)
    with pytest.raises(TypeError, match="uint8"):
        crc(np.zeros((1, 5)), 16)  # type: ignore[arg-type]
    for planes, message in ((np.zeros((2, 0)), "shape"), (np.full((1, 5), 2), "0 and 1")):
        with pytest.raises(ValueError, match=message):
            crc(planes.astype(np.uint8), 16)


def test_random_words_are_splitmix() -> None:
    """The words are those of SplitMix64, so streams do not depend on a library's generator."""
    state, words = 0x9E3779B97F4A7C15, []
    for _ in range(3):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        z = state
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB % 2**64
        words.append(z ^ (z >> 31))
    assert random_keys(0, 3).tolist() == words


@given(st.integers(0, 10**6), st.integers(1, 300))
def test_permutation(seed: int, count: int) -> None:
    assert sorted(random_permutation(seed, count)) == list(range(count))


@given(st.integers(1, 250), st.integers(0, 50))
def test_every_bit_enters_twice(num_bits: int, seed: int) -> None:
    bits = interleaved(num_bits, seed)
    np.testing.assert_array_equal(bits[:num_bits], np.arange(num_bits))
    np.testing.assert_array_equal(np.sort(bits[num_bits:]), np.arange(num_bits))


@given(st.integers(1, 300), st.integers(1, 60))
def test_releases_as_many_distinct_steps_as_bits(num_bits: int, period: int) -> None:
    order = release_order(num_bits, period)
    assert order.size == np.unique(order).size == num_bits
    assert order.min() >= 0
    assert order.max() < 2 * num_bits


def test_both_streams_are_released_by_periods() -> None:
    """Every 1/24 of the order holds one position of each period, of one parity stream."""
    order = release_order(96, 48)
    for request in range(48):
        first, second = order[2 * request : 2 * request + 2]
        assert second - first == 48
        assert first // 96 == request % 2


def test_textbook_impulse_response() -> None:
    """The (1, 5/7) code answers an impulse by 1110110..., the series of (1 + D^2) / (1 + D + D^2)."""
    table, state, parity = trellis(0b111, 0b101), 0, []
    for bit in (1, 0, 0, 0, 0, 0, 0):
        parity.append(table.output[state, bit])
        state = table.next_state[state, bit]
    assert parity == [1, 1, 1, 0, 1, 1, 0]


@pytest.mark.parametrize("polynomials", [(0b11, 0b01), (0b101, 0b111), (0b1101, 0b1011), (0b11001, 0b11011)])
def test_tables_encode_as_polynomials_divide(polynomials: tuple[int, int]) -> None:
    bits = np.random.default_rng(3).integers(0, 2, 60, dtype=np.uint8)
    table = trellis(*polynomials)
    state, parity = 0, []
    for bit in bits:
        parity.append(table.output[state, bit])
        state = table.next_state[state, bit]
    np.testing.assert_array_equal(parity, rsc_encode(bits, *polynomials))


@pytest.mark.parametrize("polynomials", [(0b111, 0b101), (0b1011, 0b1101), (0b11001, 0b11011)])
def test_transitions_pair_up(polynomials: tuple[int, int]) -> None:
    """States k and k + S/2 lead to 2k and 2k + 1, and the masks name the transitions to the even one."""
    table = trellis(*polynomials)
    half = len(table.next_state) // 2
    for state in range(2 * half):
        bit = table.input_mask >> state & 1
        assert table.next_state[state, bit] == 2 * (state % half)
        assert table.next_state[state, 1 - bit] == 2 * (state % half) + 1
        assert table.output[state, bit] == table.parity_mask >> state & 1
        assert table.output[state, 1 - bit] == 1 - (table.parity_mask >> state & 1)
