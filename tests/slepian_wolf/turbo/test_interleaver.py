"""Tests of the order in which bits enter the trellis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.slepian_wolf.permutations import random_keys, random_permutation
from dvc.slepian_wolf.turbo.interleaver import interleaved


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
    """Every element appears once."""
    assert sorted(random_permutation(seed, count)) == list(range(count))


@pytest.mark.parametrize(("num_bits", "seed"), [(0, 1), (-3, 1), (10, -1)])
def test_refuses_bad_lengths(num_bits: int, seed: int) -> None:
    """Empty planes and negative seeds are refused."""
    with pytest.raises(ValueError, match="`num_bits` must be"):
        interleaved(num_bits, seed)


@given(st.integers(1, 250), st.integers(0, 50))
def test_every_bit_enters_twice(num_bits: int, seed: int) -> None:
    """First all in order, then all in another one."""
    bits = interleaved(num_bits, seed)
    np.testing.assert_array_equal(bits[:num_bits], np.arange(num_bits))
    np.testing.assert_array_equal(np.sort(bits[num_bits:]), np.arange(num_bits))
