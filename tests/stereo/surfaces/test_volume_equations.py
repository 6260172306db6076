"""Equations (2.14) to (2.20) on volumes: what must hold for the forms that the code is compared with."""

import itertools

import numpy as np
import pytest

from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.surfaces.occupancy import shifts
from tests.reference import stereo_volumes as volumes
from tests.stereo.plane_scenes import LABELS

SHAPE = (6, 9, 5)


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(214)


def test_shears_compose_and_are_undone(rng: np.random.Generator) -> None:
    """Far from the border the shears of two moves are the shear of both, and one back undoes one (2.14)."""
    volume = np.zeros((30, 30, 4), np.int64)
    inner = slice(12, 18)
    volume[inner, inner] = rng.integers(1, 100, (6, 6, 4))
    for a, b in itertools.product([(1, 0), (0, -1), (2, 1)], [(-1, 0), (1, 1)]):
        both = volumes.sheared(volumes.sheared(volume, *b, 0), *a, 0)
        np.testing.assert_array_equal(both, volumes.sheared(volume, a[0] + b[0], a[1] + b[1], 0))
        back = volumes.sheared(volumes.sheared(volume, *a, 0), -a[0], -a[1], 0)
        np.testing.assert_array_equal(back, volume)


@pytest.mark.parametrize(("m", "n"), [(1, 0), (-1, 0), (0, 1), (2, -1)])
def test_shear_moves_points_as_views_do(m: int, n: int) -> None:
    """A voxel of camera (0, 0) is found by camera (m, n) where its point is seen, (2.5) and (2.14)."""
    row, column, label = 14, 15, 4
    volume = np.zeros((30, 30, LABELS.num_labels), bool)
    volume[row, column, label] = True
    found = np.argwhere(volumes.sheared(volume, m, n, False))
    assert found.tolist() == [[row - n * label, column - m * label, label]]
    dx, dy = shifts(LABELS, LatticePosition(0.0, 0.0), LatticePosition(m, n))[label]
    assert found[0, :2].tolist() == [row + dy, column + dx]


def test_support_only_removes(rng: np.random.Generator) -> None:
    """Nothing is added; a direction without neighbours asks for nothing; consistent voxels stay (2.15)."""
    own, left, right, above = (rng.random(SHAPE) < 0.5 for _ in range(4))
    kept = volumes.with_support(own, [left, right], [above])
    assert not (kept & ~own).any()
    np.testing.assert_array_equal(kept, own & (left | right) & above)
    np.testing.assert_array_equal(volumes.with_support(own, [], []), own)
    np.testing.assert_array_equal(volumes.with_support(own, [own, left], [own]), own)


def test_geometric_cost_in_two_passes_is_that_of_all_pairs(rng: np.random.Generator) -> None:
    """Both are one, change by one a label at most, and are nothing for an empty column (2.16)."""
    occupied = rng.random((8, 9, 12)) < 0.12
    cost = volumes.geometric_cost(occupied, 3.0)
    np.testing.assert_array_equal(cost, volumes.geometric_cost_in_two_passes(occupied, 3.0))
    empty = ~occupied.any(axis=2)
    assert 0 < empty.sum() < empty.size
    assert not cost[empty].any()
    assert np.abs(np.diff(cost, axis=2)).max() == 1.0
    assert cost.max() == 3.0
    assert not cost[occupied].any()


def test_nearest_surface_of_a_column_alone_is_visible(rng: np.random.Generator) -> None:
    """Of each column that has any, one occupied voxel is visible: (2.17), also in its closed form."""
    occupied = rng.random(SHAPE) < 0.3
    seen = volumes.visibility(occupied)
    np.testing.assert_array_equal((seen & occupied).sum(axis=2), occupied.any(axis=2))
    nearer = np.cumsum(occupied[:, :, ::-1], axis=2)[:, :, ::-1] - occupied
    np.testing.assert_array_equal(seen, nearer == 0)
    slack = volumes.visibility(occupied, 1)
    assert (slack | ~seen).all(), "slack can only show more"
    assert (slack != seen).any()
    assert slack[:, :, -2:].all()


def test_truncated_error_falls_with_every_neighbour(rng: np.random.Generator) -> None:
    """It lies between nothing and the limit; another neighbour never adds to it (2.18)."""
    own = rng.uniform(0, 30, (*SHAPE[:2], 3))
    first, second = rng.uniform(0, 30, (2, *SHAPE, 3))
    first[0] = np.nan
    one = volumes.truncated_error(own, [first], 90.0)
    two = volumes.truncated_error(own, [first, second], 90.0)
    assert (one[0] == 90.0).all()
    assert (two <= one).all()
    assert 0.0 <= two.min() < two.max() == 90.0


def test_truth_table_of_validity() -> None:
    """Visible here, and to neither neighbour: this alone is not valid (2.19)."""
    rows = list(itertools.product([False, True], repeat=3))
    own, left, right = (np.array(column).reshape(2, 2, 2) for column in zip(*rows, strict=True))
    valid = volumes.validity(own, [left, right]).ravel()
    assert [row for row, is_valid in zip(rows, valid, strict=True) if not is_valid] == [(True, False, False)]


def test_photometric_cost_is_the_mean_of_what_is_valid(rng: np.random.Generator) -> None:
    """Both: the mean; one: that one; none: not defined (2.20)."""
    across, down = rng.uniform(0, 1, (2, 1, 1, 4))
    valid = [np.array([[[True, True, False, False]]]), np.array([[[True, False, True, False]]])]
    cost = volumes.photometric_cost([across, down], valid)[0, 0]
    expected = [(across[0, 0, 0] + down[0, 0, 0]) / 2.0, across[0, 0, 1], down[0, 0, 2], np.nan]
    np.testing.assert_allclose(cost, expected)
