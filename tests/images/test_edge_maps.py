"""Edge maps: their pyramid (4.5), files, regions and masks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dvc.errors import BitstreamError, DvcError
from dvc.images import chain_code
from dvc.images.chain_code import EdgeCode, trace
from dvc.images.edge_maps import EdgeMaps, border, edges_inside, regions
from dvc.images.edge_selection import read_edges, write_edges
from dvc.picture_files import write_png
from tests.images.columns import assert_same_edges, random_edges

SHAPE = (9, 13)


def test_coarse_samples_are_separated_where_fine_ones_are():
    rng = np.random.default_rng(0)
    for shape in ((8, 8), (7, 9), (1, 5), (5, 1), (2, 3)):
        edges = random_edges(rng, shape, 0.3)
        below, right, coarse = edges.between_rows, edges.between_columns, list(edges.pyramid(2))[1]
        assert coarse.shape == ((shape[0] + 1) // 2, (shape[1] + 1) // 2)
        for s in range(coarse.shape[0] - 1):
            for t in range(coarse.shape[1]):
                assert coarse.between_rows[s, t] == max(below[2 * s, 2 * t], below[2 * s + 1, 2 * t])
        for s in range(coarse.shape[0]):
            for t in range(coarse.shape[1] - 1):
                assert coarse.between_columns[s, t] == max(right[2 * s, 2 * t], right[2 * s, 2 * t + 1])
        assert not coarse.between_rows[-1].any()
        assert not coarse.between_columns[:, -1].any()


def test_a_pyramid_begins_with_the_edges_themselves():
    edges = EdgeMaps.none((9, 9))
    edges.between_rows[3, 4] = 1
    levels = list(edges.pyramid(3))
    assert [level.shape for level in levels] == [(9, 9), (5, 5), (3, 3)]
    assert levels[0] is edges
    assert [level.count() for level in levels] == [1, 1, 1]


def test_edges_beyond_the_plane_are_refused():
    with pytest.raises(ValueError, match="no neighbours"):
        EdgeMaps(np.ones((2, 2), np.uint8), np.zeros((2, 2), np.uint8))
    with pytest.raises(ValueError, match="shape"):
        EdgeMaps(np.zeros((2, 2), np.uint8), np.zeros((2, 3), np.uint8))


def test_edges_come_back_from_files(tmp_path):
    edges = random_edges(np.random.default_rng(1), SHAPE, 0.5)
    assert (edges.between_rows & edges.between_columns).any()
    write_edges(tmp_path / "edges.png", edges)
    assert_same_edges(read_edges(tmp_path / "edges.png", SHAPE), edges)
    with pytest.raises(DvcError, match="edges of 13x9, but the depth map is 13x8"):
        read_edges(tmp_path / "edges.png", (8, 13))
    write_png(tmp_path / "grey.png", np.full(SHAPE, 84, np.uint8))
    with pytest.raises(DvcError, match="edges have the levels 0, 85, 170, 255"):
        read_edges(tmp_path / "grey.png", SHAPE)


@given(st.integers(1, 20), st.integers(1, 20), st.floats(0, 1), st.integers(0, 2**32))
def test_regions_are_numbered_by_their_first_samples(height, width, share, seed):
    edges = random_edges(np.random.default_rng(seed), (height, width), share)
    numbers = np.arange(height * width).reshape(height, width)
    down, along = edges.between_rows[:-1] == 0, edges.between_columns[:, :-1] == 0
    first_ends = np.concatenate([numbers[:-1][down], numbers[:, :-1][along]])
    second_ends = np.concatenate([numbers[1:][down], numbers[:, 1:][along]])
    graph = coo_array((np.ones(len(first_ends)), (first_ends, second_ends)), (numbers.size, numbers.size))
    labels = connected_components(graph, directed=False)[1]
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    expected = np.argsort(np.argsort(first))[inverse].reshape(height, width)
    np.testing.assert_array_equal(regions(edges), expected)


@given(
    st.integers(1, 24), st.integers(1, 24), st.floats(0, 1), st.floats(0, 1), st.sampled_from(EdgeCode),
    st.integers(0, 2**32),
)  # fmt: skip
def test_any_mask_comes_back_with_its_edges(height, width, keep, share, code, seed):
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width)) < keep
    edges = edges_inside(random_edges(rng, mask.shape, share), mask)
    data = chain_code.encode(trace(edges), code, mask)
    found, known = chain_code.decode_masked(data, mask.shape, code)
    np.testing.assert_array_equal(known, mask)
    assert_same_edges(found, edges)


@given(st.binary(max_size=40), st.sampled_from(EdgeCode))
def test_any_bytes_are_refused_or_some_mask(data, code):
    try:
        edges, mask = chain_code.decode_masked(data, (12, 17), code)
    except BitstreamError:
        return
    assert mask.shape == edges.shape
    assert not (border(mask).between_rows > edges.between_rows).any()
    assert not (border(mask).between_columns > edges.between_columns).any()


@pytest.mark.parametrize("whole", [False, True])
def test_masks_without_a_border_take_few_bytes(whole):
    mask = np.full((30, 40), whole)
    data = chain_code.encode(trace(border(mask)), EdgeCode.ADAPTIVE, mask)
    assert len(data) <= 4


def test_a_disc_takes_about_as_many_bits_as_its_border_has_edges():
    y, x = np.indices((80, 80))
    mask = np.hypot(y - 40, x - 38) < 30
    edges = border(mask)
    data = chain_code.encode(trace(edges), EdgeCode.ADAPTIVE, mask)
    assert 8 * len(data) < 1.5 * edges.count()
