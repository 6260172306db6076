"""Chains of edges and their code: the thesis's example, round trips, damage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.dibr.depth_image.depth_image_encoder import code_edges
from dvc.errors import BitstreamError, ConfigError
from dvc.images import chain_code
from dvc.images.chain_code import Chains, EdgeCode, draw, trace
from dvc.images.edge_maps import EdgeMaps, border
from tests.images.columns import assert_same_edges, random_edges
from tests.reference.freeman import code_bits, differences, directions_of

SHAPES = st.tuples(st.integers(1, 20), st.integers(1, 20))


def edges_of(shape, share, seed):
    return random_edges(np.random.default_rng(seed), shape, share)


def test_the_example_of_the_thesis_takes_seven_bits():
    steps = np.array([-1, 0, 0, 1, 0], np.int8)
    directions = directions_of(0, steps)
    np.testing.assert_array_equal(directions, [0, 3, 3, 3, 0, 0])
    np.testing.assert_array_equal(differences(directions), steps)
    body = [code_bits(Chains((30, 30), np.array([200]), np.array([n]), directions[:n])) for n in (4, 6)]
    single = code_bits(Chains((30, 30), np.array([200]), np.array([4]), np.zeros(4, np.int8)))
    assert body[0] - single == 1  # one turn in three steps
    assert body[1] == single + 4  # two more steps, one of them a turn, and lengths of three bits as before


def test_a_difference_of_three_is_a_turn_the_other_way():
    np.testing.assert_array_equal(differences(np.array([0, 3, 0, 1], np.int8)), [-1, 1, 1])


@given(SHAPES, st.floats(0, 1), st.integers(0, 2**32))
def test_chains_are_drawn_as_they_were_traced(shape, share, seed):
    edges = edges_of(shape, share, seed)
    chains = trace(edges)
    assert len(chains.directions) == edges.count() == chains.lengths.sum()
    assert (np.diff(chains.starts) >= 0).all()
    assert_same_edges(draw(chains), edges)


@pytest.mark.nojit
def test_chains_are_as_few_as_there_can_be():
    cross = EdgeMaps.none((8, 8))
    cross.between_rows[3, 1:7] = 1
    cross.between_columns[1:7, 3] = 1
    assert sorted(trace(cross).lengths) == [6, 6]
    ring = EdgeMaps.none((8, 8))
    ring.between_rows[1, 2:5] = ring.between_rows[4, 2:5] = 1
    ring.between_columns[2:5, 1] = ring.between_columns[2:5, 4] = 1
    assert list(trace(ring).lengths) == [12]
    tee = EdgeMaps.none((8, 8))
    tee.between_rows[3, 1:7] = 1
    tee.between_columns[4:7, 3] = 1
    assert sorted(trace(tee).lengths) == [3, 6]


@pytest.mark.parametrize("code", EdgeCode)
@given(SHAPES, st.floats(0, 1), st.integers(0, 2**32))
def test_edges_come_back_from_either_code(code, shape, share, seed):
    edges = edges_of(shape, share, seed)
    data = chain_code.encode(trace(edges), code)
    if edges.count():
        assert_same_edges(chain_code.decode(data, shape, code), edges)
    else:
        with pytest.raises(BitstreamError, match="none"):
            chain_code.decode(data, shape, code)


@pytest.mark.nojit
def test_code_words_take_the_bits_that_are_counted():
    edges = edges_of((40, 50), 0.05, 3)
    chains = trace(edges)
    assert 0 <= 8 * len(chain_code.encode(chains, EdgeCode.FIXED)) - code_bits(chains) <= 32


def test_chains_that_code_words_cannot_count_are_refused_and_coded_otherwise(monkeypatch):
    edges = edges_of((40, 50), 0.05, 3)
    monkeypatch.setattr(chain_code, "_LENGTH_BITS", 5)
    assert len(trace(edges).starts) >= 32
    with pytest.raises(ConfigError, match="chains"):
        chain_code.encode(trace(edges), EdgeCode.FIXED)
    assert code_edges(edges).code is EdgeCode.ADAPTIVE


def test_arithmetic_coding_is_shorter_for_contours():
    y, x = np.mgrid[:200, :200]
    chains = trace(border(np.hypot(y - 100, x - 90) < 60))
    adaptive, fixed = (len(chain_code.encode(chains, code)) for code in (EdgeCode.ADAPTIVE, EdgeCode.FIXED))
    assert len(chains.starts) == 1
    assert adaptive < 0.8 * fixed


@pytest.mark.parametrize("code", EdgeCode)
@given(SHAPES, st.binary(max_size=60))
def test_any_bytes_are_edges_or_refused(code, shape, data):
    try:
        edges = chain_code.decode(data, shape, code)
    except BitstreamError:
        return
    assert edges.shape == shape


def test_a_chain_that_leaves_the_plane_is_refused():
    with pytest.raises(ValueError, match="leaves"):
        draw(Chains((3, 3), np.array([0]), np.array([1]), np.zeros(1, np.int8)))
