"""The eight tests, each on data where right and wrong are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.arrays import Floats
from sfm.correspondences import outliers
from sfm.scene_model import Correspondences
from tests.reference import sfm_matching as reference
from tests.sfm.textures import forwards, sideways


def scattered(count: int, seed: int) -> Floats:
    return np.random.default_rng(seed).uniform([10, 10], [340, 278], (count, 2))


def moved(first: Floats, motion: Floats) -> Correspondences:
    return Correspondences(first, first + motion, np.zeros(len(first)))


def test_mse() -> None:
    error = np.array([1.0, 5.0, np.inf])
    assert outliers.mse(error, 5.0).tolist() == [True, True, False]
    assert outliers.mse(error, np.array([0.5, 9.0, 9.0])).tolist() == [False, True, False]


def test_unicity_prefers_the_better_sum() -> None:
    i, j = np.array([0, 0, 1, 1]), np.array([7, 9, 7, 9])
    keep = outliers.unicity(i, j, np.array([1.0, 2.0, 2.0, 8.0]), 10.0)
    assert keep.tolist() == [False, True, True, False]
    # A pair that is worth less than those it blocks is left out, and no pair at all is no error.
    keep = outliers.unicity(np.array([0, 1]), np.array([3, 3]), np.array([4.0, 1.0]), 5.0)
    assert keep.tolist() == [False, True]
    none = np.empty(0, dtype=np.int64)
    assert outliers.unicity(none, none, np.empty(0), 1.0).shape == (0,)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5), st.floats(0, 9)), max_size=25))
def test_unicity_is_one_to_one(pairs: list[tuple[int, int, float]]) -> None:
    pairs = list({(i, j): (i, j, e) for i, j, e in pairs}.values())
    i, j = (np.array([p[k] for p in pairs], dtype=np.int64) for k in (0, 1))
    keep = outliers.unicity(i, j, np.array([p[2] for p in pairs]), 10.0)
    assert len(set(i[keep])) == len(set(j[keep])) == keep.sum()
    assert all(a in i[keep] or b in j[keep] for a, b in zip(i, j, strict=True))


def test_epipolar() -> None:
    motion = np.zeros((30, 2))
    motion[:, 0], motion[4, 1], motion[9, 1] = np.linspace(-20, 20, 30), 0.4, -2.0
    keep = outliers.epipolar(moved(scattered(30, 1), motion), sideways(), 0.5)
    assert np.flatnonzero(~keep).tolist() == [9]


def test_motion() -> None:
    first = scattered(150, 2)
    motion = np.column_stack([5 + 0.05 * first[:, 0], -3 + 0.03 * first[:, 1]])
    wrong = np.arange(0, 150, 10)
    motion[wrong] += np.random.default_rng(3).choice([-15.0, 15.0], (15, 2))
    keep = outliers.motion(moved(first, motion))
    assert not keep[wrong].any()
    assert np.delete(keep, wrong).mean() > 0.95
    # Two surfaces that move differently by 12 px both stay, up to a few points at their border.
    motion = np.where(first[:, :1] < 176, [3.0, 0.0], [15.0, 0.0])
    assert outliers.motion(moved(first, motion)).mean() > 0.9


def test_reprojection() -> None:
    second = np.array([[10.0, 10.0], [20.0, 20.0], [30.0, 30.0]])
    projected = np.array([[10.6, 10.7], [20.0, 21.1], [np.nan, np.inf]])
    assert outliers.reprojection(second, projected).tolist() == [True, False, False]


def test_chirality() -> None:
    a = np.array([1.0, 2.0, -1.0, 3.0, 0.0, np.inf, np.nan])
    b = np.array([1.0, 2.0, 1.0, 0.5, 1.0, 1.0, 1.0])
    expected = [True, True, False, True, False, False, False]
    assert outliers.chirality(a, b).tolist() == expected
    assert outliers.chirality(a, -b).tolist() == expected


def test_epipole() -> None:
    """Points near the epipole of either frame go; an epipole at infinity is near nothing."""
    first = np.array([[100.0, 80.0], [107.0, 80.0], [150.0, 80.0], [60.0, 80.0]])
    second = np.array([[150.0, 80.0], [150.0, 80.0], [104.0, 80.0], [20.0, 80.0]])
    pairs = Correspondences(first, second, np.zeros(4))
    assert outliers.epipole(pairs, forwards((100.0, 80.0))).tolist() == [False, False, False, True]
    assert outliers.epipole(pairs, sideways((0.6, 0.8))).all()


def test_depth() -> None:
    first = scattered(150, 5)
    depths = 1.0 / (0.2 + 0.002 * first[:, 0])
    wrong = np.arange(0, 150, 15)
    depths[wrong] *= np.where(np.arange(10) % 2, 4.0, 0.25)
    depths[7], depths[8], depths[9] = np.nan, np.inf, 0.0
    keep = outliers.depth(first, depths)
    assert not keep[wrong].any()
    assert not keep[[7, 8, 9]].any()
    assert keep.sum() > 130
    assert not outliers.depth(first, np.full(150, np.nan)).any()


@pytest.mark.parametrize(("inverse", "stays"), [(0.3, False), (3.0, True)])
def test_depth_of_small_groups(monkeypatch: pytest.MonkeyPatch, inverse: float, stays: bool) -> None:
    """A few points that agree go if they are behind all their surroundings, and stay if before them."""
    first = scattered(400, 6)
    group = np.argsort(((first - [170, 140]) ** 2).sum(axis=1))[:6]
    inverse_depths = np.ones(400)
    inverse_depths[group] = inverse
    monkeypatch.setattr(outliers, "DEPTH_SHARE", 5.0)
    keep = outliers.depth(first, 1.0 / inverse_depths)
    assert keep[group].all() == stays
    assert keep[group].any() == stays
    assert np.delete(keep, group).all()
    monkeypatch.setattr(outliers, "ISLAND_SHARE", 0.0)
    assert outliers.depth(first, 1.0 / inverse_depths).all()


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 2)),
        np.array([[3.0, 4.0]]),
        np.array([[3.0, 4.0], [5.0, 9.0]]),
        np.column_stack([np.arange(9.0), 2 * np.arange(9.0)]),
        np.full((5, 2), 7.0),
    ],
)
def test_points_without_triangles(points: Floats) -> None:
    """None, one, two, collinear and coincident points pass every test when they agree."""
    pairs = moved(points, np.full(points.shape, 2.0))
    assert outliers.motion(pairs).all()
    assert outliers.depth(points, np.ones(len(points))).all()


def test_neighbours_on_a_line() -> None:
    """On a line, neighbours are the points before and after, and an aberrant motion is still found."""
    points = np.column_stack([np.arange(9.0) * 10, np.full(9, 5.0)])
    around = outliers.delaunay_neighbours(points)
    assert sorted(zip(around.point, around.neighbour, strict=True)) == sorted(
        [(k, k + 1) for k in range(8)] + [(k + 1, k) for k in range(8)]
    )
    np.testing.assert_allclose(around.weight, 0.1)
    motion = np.zeros((9, 2))
    motion[4] = 30.0
    assert np.flatnonzero(~outliers.motion(moved(points, motion))).tolist() == [4]


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(-9, 9), st.floats(0.1, 5)), max_size=30))
def test_weighted_medians(rows: list[tuple[int, float, float]]) -> None:
    point = np.array([r[0] for r in rows], dtype=np.int64)
    values, weight = (np.array([r[k] for r in rows], dtype=np.float64) for k in (1, 2))
    medians = outliers.weighted_median(values, point, weight, 5)
    for k in range(5):
        own = point == k
        if own.any():
            assert medians[k] == reference.weighted_median(values[own], weight[own])
        else:
            assert np.isnan(medians[k])
