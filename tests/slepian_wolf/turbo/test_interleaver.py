"""Tests of the layout of copies along the trellis."""

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.slepian_wolf import family
from dvc.slepian_wolf.turbo.interleaver import (
    MAX_SEGMENT_BITS,
    copy_counts,
    copy_layout,
    num_segments,
    random_keys,
    random_permutation,
)

CODES = (*family("adaptive"), *family("classical"))


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


@given(st.integers(1, 250), st.integers(0, 50), st.sampled_from(CODES))
def test_every_bit_enters_as_often_as_it_should(num_bits: int, seed: int, code: object) -> None:
    """Copies are neither lost nor added, at any length."""
    assert isinstance(code, type(CODES[0]))
    layout = copy_layout(code, num_bits, seed)
    counts = np.bincount(layout.bit_at_step, minlength=num_bits)
    if code.layout == "parallel":
        assert (counts == 2).all()
    else:
        np.testing.assert_array_equal(counts, copy_counts(code, num_bits, seed))


def test_bits_with_few_copies_meet_once() -> None:
    """Hardly any two bits with two copies are neighbours twice, which a random layout does often."""
    code = family("adaptive")[7]
    layout = copy_layout(code, 1584, 1)
    steps = defaultdict(list)
    for step, bit in enumerate(layout.bit_at_step):
        steps[bit].append(step)
    pairs = defaultdict(int)
    for step in range(layout.num_steps - 3):
        for near in range(step + 1, step + 4):
            a, b = sorted((int(layout.bit_at_step[step]), int(layout.bit_at_step[near])))
            if len(steps[a]) == len(steps[b]) == 2:
                pairs[a, b] += 1
    assert max(pairs.values()) == 1
    assert all(abs(np.diff(sorted(where))).min() > 3 for where in steps.values() if len(where) > 1)


def test_long_planes_are_divided() -> None:
    """Segments hold every S-th bit and start with an empty register."""
    num_bits = 2 * MAX_SEGMENT_BITS + 5
    layout = copy_layout(family("adaptive")[6], num_bits, 1)
    assert num_segments(num_bits) == len(layout.segment_starts) == 3
    edges = [*layout.segment_starts, layout.num_steps]
    for segment in range(3):
        assert set(layout.bit_at_step[edges[segment] : edges[segment + 1]] % 3) == {segment}


@pytest.mark.parametrize(("num_bits", "seed"), [(0, 1), (-3, 1), (10, -1)])
def test_refuses_bad_lengths(num_bits: int, seed: int) -> None:
    """Empty planes and negative seeds are refused."""
    with pytest.raises(ValueError, match="`num_bits` must be"):
        copy_layout(CODES[0], num_bits, seed)
