"""Tests of the order of release."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dvc.slepian_wolf.turbo.puncturing import release_order, spread_order


@given(st.integers(1, 400))
def test_spread_order_is_a_permutation(count: int) -> None:
    """Bit-reversed counting visits every number once."""
    assert sorted(spread_order(count)) == list(range(count))


@given(st.integers(1, 300), st.integers(1, 60))
def test_releases_as_many_distinct_steps_as_bits(num_bits: int, period: int) -> None:
    """N parity bits of the two streams are released, each once, at every length."""
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
