"""The compiled loops of layers and sprites, compiled and as Python, against their plain twins."""

import numpy as np
import pytest

from dvc.layers import canvas, layered_depth_image, sprites
from tests.reference import stereo_layers as reference
from tests.twins import Choose

pytestmark = pytest.mark.nojit
BASELINES = np.array([0.0, 0.5, 1.0, 1.5, 2.0])


@pytest.mark.parametrize(("dm", "dn"), [(1.0, 0.0), (0.0, -1.0), (0.63, -1.21)])
def test_judge(choose: Choose, rng: np.random.Generator, dm: float, dn: float) -> None:
    disparity, other = (rng.integers(0, 7, (12, 14)).astype(np.float32) for _ in range(2))
    verdict = choose(layered_depth_image.judge)(disparity, other, dm, dn, 1.0)
    expected = reference.judged(disparity.astype(float), other.astype(float), dm, dn, 1.0)
    np.testing.assert_array_equal(verdict, expected)
    assert set(np.unique(verdict)) == {0, 1, 2}


@pytest.mark.parametrize(("m", "n"), [(0.0, 0.0), (2.0, -1.0), (-1.7, 0.4)])
def test_splat(choose: Choose, rng: np.random.Generator, m: float, n: float) -> None:
    ramp = 3.0 + 0.55 * np.arange(7) + 0.3 * np.arange(5)[:, None]
    disparity = (ramp + (rng.random((5, 7)) < 0.1) * 4.0).astype(np.float32)
    votes = rng.random((5, 7)) < 0.95
    corner, shape = (-3, -2), (14, 18)
    expected = reference.splatted(disparity.astype(np.float64), votes, m, n, corner, shape, 1.0)
    counts = np.zeros(shape[0] * shape[1], np.int64)
    entry = disparity, votes, m, n, corner, shape, 1.0, 4
    nothing = np.empty(0, np.float32), np.empty(0, np.int16)
    choose(canvas.splat)(*entry, counts, *nothing)
    assert counts.tolist() == [len(values) for values in expected.values()]
    starts = np.concatenate([[0], np.cumsum(counts)])
    points, cameras = np.empty(starts[-1], np.float32), np.empty(starts[-1], np.int16)
    choose(canvas.splat)(*entry, starts[:-1].copy(), points, cameras)
    choose(canvas.sort_points)(starts, points, cameras)
    for number, values in enumerate(expected.values()):
        found = points[starts[number] : starts[number + 1]]
        np.testing.assert_allclose(found, sorted(values, reverse=True), atol=1e-4)
    assert (cameras == 4).all()


def test_peel(choose: Choose, rng: np.random.Generator) -> None:
    num_layers = set()
    for _ in range(200):
        count = int(rng.integers(1, 12))
        points = (rng.integers(0, 40, count) * 0.25).astype(np.float32)
        cameras = rng.integers(0, 5, count).astype(np.int16)
        owner = int(rng.integers(-1, 5))
        pairs = list(zip(points.astype(float).tolist(), cameras.tolist(), strict=True))
        expected = reference.peeled(sorted(set(pairs)), 0.0, 0.5, 1, BASELINES, owner)
        points, cameras = (np.array(part) for part in zip(*sorted(set(pairs)), strict=True))
        points, cameras, count = points.astype(np.float32), cameras.astype(np.int16), len(points)
        choose(canvas.sort_points)(np.array([0, count]), points, cameras)
        levels = np.array([reference.label_of(float(d), 0.0, 0.5) for d in points])
        alive, chosen = np.ones(count, np.bool_), np.zeros(count, np.bool_)
        state = np.zeros(5, np.bool_), alive, chosen
        found = []
        while alive.any():
            cell = points, cameras, levels
            found.append(choose(layered_depth_image.peel)(*cell, 0.5, 1, BASELINES, owner, *state))
            assert chosen.sum() == found[-1][1]
            owner = -1
        assert len(found) == len(expected)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        num_layers.add(len(found))
    assert num_layers >= {1, 2, 3, 4}


@pytest.mark.parametrize("rho", [(0.02, 0.49), (0.1, 0.3)])
def test_likelihood(choose: Choose, rng: np.random.Generator, rho: tuple[float, float]) -> None:
    depth = rng.choice([0.0, 0.0, 0.0, 1.0, 3.0], (5, 6))
    mask = np.zeros(depth.shape, np.bool_)
    mask[1:3, 1:3] = True
    order, entered = np.empty(depth.size, np.int64), np.zeros(depth.shape, np.bool_)
    everywhere = np.ones(depth.shape, np.bool_)
    count = choose(sprites._reach)(depth, everywhere, mask, 1.5, order, entered)
    assert entered.sum() == count == len(set(order[:count]))
    messages = np.full((*depth.shape, 4), 0.5)
    got = choose(sprites._likelihood)(depth, mask, entered, order[:count], *rho, messages)
    expected = reference.likelihoods(depth, mask, 0.5, 1.5, rho, 150)
    np.testing.assert_allclose(got[entered], expected[entered], atol=20 * sprites.TOLERANCE)
    assert (expected[~entered] <= 0.5 + 1e-12).all()


def test_transitions(choose: Choose) -> None:
    """Likelihoods along a chain follow the transitions of (2.22)."""
    depth = np.array([[0.0, 0.0, 1.0, 5.0, 5.0]])
    mask = np.array([[True, False, False, False, False]])
    order, entered = np.arange(5), np.ones((1, 5), np.bool_)
    messages = np.full((1, 5, 4), 0.5)
    got = choose(sprites._likelihood)(depth, mask, entered, order, 0.1, 0.3, messages)
    second = 0.9
    third = (1 - 0.6) * second + 0.3
    fourth = min(1 - third, 0.5)
    np.testing.assert_allclose(got, [[1.0, second, third, fourth, (1 - 0.2) * fourth + 0.1]], atol=1e-9)
