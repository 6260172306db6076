"""Selection of edges: a plain twin of its cost, and contours that pay or do not."""

from itertools import pairwise

import numpy as np
import pytest

from dvc.images import edge_selection as selection
from dvc.images.chain_code import trace
from dvc.images.edge_maps import degree, next_vertex
from dvc.images.edge_selection import (
    BITS_PER_OCTAVE,
    MULTIPLIER,
    SIGNIFICANCE_BITS,
    edges_of_jumps,
    ladder,
    select,
)
from dvc.images.lifting import WAVELETS, Transform
from tests.dibr.scenes import two_discs
from tests.images.columns import random_edges

WEIGHTS = WAVELETS["9/7"]


def plain_cost(plane, edges, num_levels, order):
    total = 0.0
    for details in Transform(num_levels, edges=edges, order=order).analyse(plane).details:
        for band in details:
            for magnitude in np.abs(band).ravel():
                bits = SIGNIFICANCE_BITS + BITS_PER_OCTAVE * np.log2(max(magnitude, 1.0))
                coded = 1 / 12 + MULTIPLIER * bits
                total += magnitude**2 if magnitude < 0.5 else min(magnitude**2, coded)
    return total


@pytest.mark.nojit
@pytest.mark.parametrize("shape", [(32, 32), (21, 34), (1, 16), (16, 1)])
def test_the_cost_of_a_transform_is_that_of_a_plain_twin(shape):
    rng = np.random.default_rng(4)
    plane = 5.0 * rng.normal(size=shape)
    edges = random_edges(rng, shape, 0.1)
    maps = edges.between_rows, edges.between_columns
    wavelet = (np.array(WEIGHTS.weights), WEIGHTS.gain, *WEIGHTS.scales)
    found = selection.transform_cost(plane, *maps, 3, wavelet, 1)
    assert found == pytest.approx(plain_cost(plane, edges, 3, 1), rel=1e-9)


def test_contours_of_objects_are_kept_and_steps_of_slopes_are_not():
    depth = np.round(4 * two_discs()) / 4  # the slope of the background becomes steps of a quarter
    edges = select(depth, edges_of_jumps(depth, 0.2), 2.0, 1)
    contours = edges_of_jumps(depth, 5.0)
    candidates = edges_of_jumps(depth, 0.2)
    assert candidates.count() > 2 * contours.count()
    kept = np.sum(edges.between_columns & contours.between_columns)
    kept += np.sum(edges.between_rows & contours.between_rows)
    assert kept >= 0.97 * contours.count()
    assert edges.count() <= 1.1 * contours.count()


def test_hardly_any_edge_of_noise_pays():
    depth = np.random.default_rng(0).normal(size=(48, 48))
    candidates = edges_of_jumps(depth, 1.0)
    assert select(depth, candidates, 4.0, 1).count() < 0.2 * candidates.count()


def test_a_ladder_leads_to_fewer_edges_each_out_of_those_before():
    depth = two_discs()
    steps = list(ladder(depth, 20000.0, 1))
    assert len(steps) > 4
    for (step, edges), (coarser_step, fewer) in pairwise(steps):
        assert step < coarser_step
        assert not (fewer.between_rows & ~edges.between_rows).any()
        assert not (fewer.between_columns & ~edges.between_columns).any()
    assert steps[-1][1].count() < steps[0][1].count()


def test_pieces_end_where_chains_meet_and_are_short():
    rng = np.random.default_rng(1)
    edges = random_edges(rng, (40, 60), 0.2)
    edges.between_rows[20] = 1
    chains = trace(edges)
    elements, bounds = selection._pieces(chains, edges)
    assert (elements[:, 2] == chains.directions).all()
    ends = set(np.cumsum(chains.lengths).tolist())
    for number, (row, column, direction) in enumerate(elements.tolist()):
        if number + 1 not in ends:
            assert list(next_vertex(row, column, direction)) == elements[number + 1, :2].tolist()
    meeting = [
        number
        for number, (row, column, _) in enumerate(elements.tolist())
        if number == 0
        or number in ends
        or degree(edges.between_rows, edges.between_columns, row, column) != 2
    ]
    assert set(meeting) <= set(bounds.tolist())
    assert np.diff(bounds).max() <= 32
    assert len(bounds) - 1 == sum(-(-int(length) // 32) for length in np.diff([*meeting, len(elements)]))


def test_constant_maps_have_no_ladder():
    assert list(ladder(np.full((16, 16), 3.0), 1000.0, 1)) == []
