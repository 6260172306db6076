"""Tests of the order of release."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.slepian_wolf import TurboCode, family
from dvc.slepian_wolf.turbo.interleaver import MAX_SEGMENT_BITS, copy_layout
from dvc.slepian_wolf.turbo.puncturing import depuncture, puncture, release_order, spread_order

CODES = (*family("adaptive"), *family("classical"))


@given(st.integers(1, 400))
def test_spread_order_is_a_permutation(count: int) -> None:
    """Bit-reversed counting visits every number once."""
    assert sorted(spread_order(count)) == list(range(count))


@given(st.integers(1, 300), st.sampled_from(CODES))
def test_releases_as_many_distinct_steps_as_bits(num_bits: int, code: TurboCode) -> None:
    """N parity bits are released, each once, at every length."""
    order = release_order(code, num_bits)
    assert order.size == num_bits
    assert np.unique(order).size == num_bits
    assert order.min() >= 0
    assert order.max() < copy_layout(code, num_bits, 0).num_steps


@pytest.mark.parametrize("code", family("adaptive"), ids=lambda code: code.name)
@pytest.mark.parametrize("count", [40, 170, 400, 1100, 1584])
def test_every_prefix_is_spread(code: TurboCode, count: int) -> None:
    """Whatever was released, the gaps between released steps stay within a small multiple of their mean."""
    order = np.sort(release_order(code, 1584)[:count])
    num_steps = copy_layout(code, 1584, 0).num_steps
    assert order[-1] == num_steps - 1
    assert np.diff(order, prepend=-1).max() <= 2.1 * num_steps / count + 1


def test_classical_releases_both_streams_by_periods() -> None:
    """Every 1/24 of the classical order holds one position of each period, of both parity streams."""
    order = release_order(family("classical")[0], 96)
    for request in range(24):
        steps = order[4 * request : 4 * request + 4]
        assert (np.diff(steps) == [48, 48, 48]).all()


@given(st.data(), st.integers(1, 120), st.sampled_from(CODES))
def test_depuncture_inverts_puncture(data: st.DataObject, num_bits: int, code: TurboCode) -> None:
    """After any number of requests the sent bits are back at their steps, and nothing else."""
    order = release_order(code, num_bits)
    parity = np.random.default_rng(num_bits).integers(
        0, 2, copy_layout(code, num_bits, 1).num_steps, dtype=np.uint8
    )
    cuts = sorted(data.draw(st.lists(st.integers(0, num_bits), max_size=4)))
    received = [puncture(parity, order, a, b - a) for a, b in zip([0, *cuts[:-1]], cuts, strict=False)]
    back = depuncture(np.concatenate([np.zeros(0, np.uint8), *received]), order, parity.size)
    known = np.zeros(parity.size, bool)
    known[order[: cuts[-1] if cuts else 0]] = True
    np.testing.assert_array_equal(back[known], parity[known])
    assert (back[~known] == -1).all()


def test_segments_take_turns() -> None:
    """A divided plane releases parity of all segments in turn."""
    num_bits = MAX_SEGMENT_BITS + 3
    order = release_order(CODES[5], num_bits)
    second = copy_layout(CODES[5], num_bits, 0).segment_starts[1]
    assert np.unique(order).size == num_bits
    assert (order[0::2] < second).all()
    assert (order[1::2] >= second).all()


def test_refuses_ranges_that_do_not_exist() -> None:
    """Nothing beyond the order can be sent or received."""
    order = release_order(CODES[0], 10)
    parity = np.zeros(copy_layout(CODES[0], 10, 1).num_steps, np.uint8)
    with pytest.raises(ValueError, match="outside the 10 bits"):
        puncture(parity, order, 5, 6)
    with pytest.raises(ValueError, match="only 10"):
        depuncture(np.zeros(11, np.uint8), order, parity.size)
