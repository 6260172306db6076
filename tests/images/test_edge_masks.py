"""Masks by edges: regions, round trips with any mask, and what they take."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import BitstreamError
from dvc.images import chain_code
from dvc.images.chain_code import EdgeCode, trace
from dvc.images.edge_maps import EdgeMaps, border, edges_inside, regions


def random_edges(rng, shape, share):
    below, right = ((rng.random(shape) < share).astype(np.uint8) for _ in range(2))
    below[-1:], right[:, -1:] = 0, 0
    return EdgeMaps(below, right)


def plain_regions(edges):
    """Number regions by filling each from its first sample."""
    height, width = edges.shape
    found = np.full((height, width), -1)
    for row, column in np.ndindex(height, width):
        if found[row, column] >= 0:
            continue
        number, ways = found.max() + 1, [(row, column)]
        while ways:
            y, x = ways.pop()
            if found[y, x] >= 0:
                continue
            found[y, x] = number
            if y + 1 < height and not edges.between_rows[y, x]:
                ways.append((y + 1, x))
            if y > 0 and not edges.between_rows[y - 1, x]:
                ways.append((y - 1, x))
            if x + 1 < width and not edges.between_columns[y, x]:
                ways.append((y, x + 1))
            if x > 0 and not edges.between_columns[y, x - 1]:
                ways.append((y, x - 1))
    return found


@given(st.integers(1, 20), st.integers(1, 20), st.floats(0, 1), st.integers(0, 2**32))
def test_regions_are_numbered_by_their_first_samples(height, width, share, seed):
    edges = random_edges(np.random.default_rng(seed), (height, width), share)
    np.testing.assert_array_equal(regions(edges), plain_regions(edges))


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
    np.testing.assert_array_equal(found.between_rows, edges.between_rows)
    np.testing.assert_array_equal(found.between_columns, edges.between_columns)


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
