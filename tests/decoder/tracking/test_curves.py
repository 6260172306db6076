"""Common motion of a frame among clutter, and snakes: equations against dense algebra, smoothness."""

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.curves import (
    ALIKE_PX,
    BENDING,
    NEAR_PX,
    SNAKE_RIDGE,
    ReceivedPoints,
    _Smoothness,
    affine_terms,
    fit_snakes,
    register,
)
from sfm.correspondences.outliers import delaunay_neighbours

Floats = NDArray[np.float64]


def scattered(count: int, seed: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    first = rng.uniform([10, 10], [340, 270], (count, 2))
    return first, first + np.array([30.0, 6.0]) * rng.uniform(0.3, 1.0, (count, 1))


def received(points: Floats, seed: int) -> ReceivedPoints:
    """Detect half of the points in whole pixels, and as many others."""
    rng = np.random.default_rng(seed)
    seen = points[rng.random(len(points)) < 0.5]
    return ReceivedPoints(np.unique(np.rint([*seen, *rng.uniform(0, 280, seen.shape)]), axis=0))


def test_shift_turn_and_temporal_offset_are_found() -> None:
    first, second = scattered(200, 1)
    turn = 0.01 * np.column_stack([-(first[:, 1] - 140), first[:, 0] - 170])
    truth = [
        np.array([9.0, -12.0]) + turn - 0.2 * (second - first),
        np.array([-6.0, 5.0]) + 0.15 * (second - first),
    ]
    even = [(2 * first + second) / 3, (first + 2 * second) / 3]
    frames = [received(e + d, seed) for seed, (e, d) in enumerate(zip(even, truth, strict=True))]
    found = register(first, second, np.array([1, 2]) / 3, frames)
    error = np.linalg.norm(found - np.stack(truth), axis=2)
    assert np.quantile(error, 0.95) < 0.5


def test_without_points_nothing_deviates() -> None:
    first, second = scattered(20, 2)
    frames = [ReceivedPoints(np.empty((0, 2)))]
    assert not register(first, second, np.array([0.5]), frames).any()


def test_terms_are_bounded() -> None:
    first, second = scattered(50, 3)
    terms = affine_terms(first, second)
    assert np.abs(terms).max() <= 2.0
    assert affine_terms(first[:1], second[:1]).tolist() == [[1.0, 0.0, 0.0, 0.0, 0.0]]


def test_a_corner_belongs_to_one_place() -> None:
    corners = ReceivedPoints(np.array([[10.0, 10.0], [50.0, 10.0]]))
    chosen, found, distance = corners.match(np.array([[12.0, 10.0], [11.0, 10.0], [55.0, 10.0]]), 3.0)
    assert (chosen.tolist(), found.tolist(), distance.tolist()) == ([1], [0], [1.0])


def normal_matrix(first: Floats, second: Floats, num_frames: int) -> Floats:
    """Write the smoothness out as a dense matrix (N T, N T): the plain twin."""
    count = len(first)
    matrix = SNAKE_RIDGE * np.eye(count * num_frames)
    for i in range(count):
        for k in range(num_frames):
            row = np.zeros((count, num_frames))
            row[i, k] = 2.0
            row[i, [j for j in (k - 1, k + 1) if 0 <= j < num_frames]] = -1.0
            matrix += BENDING * np.outer(row, row)
    around = delaunay_neighbours(0.5 * (first + second))
    for a, b in {(min(pair), max(pair)) for pair in zip(around.point, around.neighbour, strict=True)}:
        apart = np.sum((0.5 * (first[a] + second[a] - first[b] - second[b])) ** 2)
        unlike = np.sum((second[a] - first[a] - second[b] + first[b]) ** 2)
        weight = 1 / (1 + apart / NEAR_PX**2) / (1 + unlike / ALIKE_PX**2)
        for k in range(num_frames):
            row = np.zeros((count, num_frames))
            row[a, k], row[b, k] = 1.0, -1.0
            matrix += weight * np.outer(row, row)
    return matrix


def test_conjugate_gradients_solve_the_normal_equations() -> None:
    rng = np.random.default_rng(1)
    first = rng.uniform(0, 100, (12, 2))
    second = first + rng.uniform(-8, 8, (12, 2))
    weight = rng.random((12, 5)) * (rng.random((12, 5)) < 0.6)
    right = weight[..., None] * rng.uniform(-3, 3, (12, 5, 2))
    found = _Smoothness(first, second, 5).solve(weight, right, np.zeros((12, 5, 2)))
    matrix = normal_matrix(first, second, 5) + np.diag(weight.ravel())
    expected = np.linalg.solve(matrix, right.reshape(-1, 2)).reshape(12, 5, 2)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_neighbours_carry_what_is_not_seen() -> None:
    columns, rows = np.meshgrid(np.arange(5) * 20.0, np.arange(5) * 20.0)
    first = np.column_stack([columns.ravel(), rows.ravel()]) + 30.0
    expected = np.repeat(first[:, None], 3, axis=1)
    shift = np.array([1.5, -1.0])
    seen = np.delete(first, 12, axis=0) + shift
    frames = [ReceivedPoints(seen)] * 3
    snakes = fit_snakes(first, first, expected, frames)
    np.testing.assert_allclose(snakes.positions[12, 1] - first[12], shift, atol=0.3)
    assert np.isnan(snakes.received[12]).all()
    assert np.isfinite(np.delete(snakes.received, 12, axis=0)).all()


def test_points_far_away_do_not_pull() -> None:
    first = np.array([[20.0, 20.0], [60.0, 20.0], [40.0, 50.0], [70.0, 70.0]])
    expected = np.repeat(first[:, None], 2, axis=1)
    snakes = fit_snakes(first, first, expected, [ReceivedPoints(first + 9.0)] * 2)
    np.testing.assert_array_equal(snakes.positions, expected)
