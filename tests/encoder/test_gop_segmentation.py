"""Segmentation into groups at the least estimated rate."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from encoder.gop_segmentation import first_length, group_costs, wyner_ziv_share


def min_cost(costs: list[float], total: int, min_length: int) -> tuple[float, int]:
    """Try all segmentations; the second value is the longest first group of the cheapest."""
    best = (np.inf, 0)
    for borders in itertools.product([False, True], repeat=total - 1):
        edges = [0, *(i + 1 for i, border in enumerate(borders) if border), total]
        sizes = [b - a for a, b in itertools.pairwise(edges)]
        if min(sizes) >= min(min_length, total):
            best = min(best, (float(sum(costs[n] for n in sizes)), -sizes[0]))
    return best[0], -best[1]


@given(st.lists(st.integers(0, 20), min_size=1, max_size=8), st.integers(1, 5))
def test_first_group_is_that_of_the_cheapest_segmentation(values: list[int], min_length: int) -> None:
    """Dynamic programming finds what the trial of all segmentations finds."""
    costs = [0.0, *map(float, values)]
    assert first_length(np.array(costs), min_length) == min_cost(costs, len(values), min_length)[1]


@pytest.mark.parametrize("hierarchical", [False, True])
def test_costs_grow_with_length_and_change(hierarchical: bool) -> None:
    """A key frame alone costs 1; more frames, more change and more loss cost more."""
    still, moving = (
        group_costs([change] * 9, [lost] * 9, hierarchical) for change, lost in ((0, 0), (9, 0.5))
    )
    assert (still[0], still[1], moving[1]) == (0.0, 1.0, 1.0)
    assert (np.diff(still) > 0).all()
    assert (moving[2:] > still[2:]).all()
    assert still[4] == pytest.approx(1 + 3 * wyner_ziv_share(0.0, 0.0))


def test_change_over_time_makes_groups_short() -> None:
    """Frames that are like each other make one group, those that soon differ several."""
    assert first_length(group_costs([0.5] * 16, [0.0] * 16, True), 2) == 16
    steep = group_costs([2.0 * n for n in range(1, 17)], [0.06 * n for n in range(1, 17)], True)
    assert 2 <= first_length(steep, 2) < 16


def test_levels_are_nearer_to_their_references() -> None:
    """Where blocks change with time, decoded references make a group cheaper than key frames alone."""
    changes, lost = [float(n) for n in range(1, 9)], [0.0] * 8
    assert group_costs(changes, lost, True)[8] < group_costs(changes, lost, False)[8]
