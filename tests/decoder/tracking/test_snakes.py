"""Snakes: their equations against dense algebra, and what smoothness carries to where nothing is seen."""

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.curves import ReceivedPoints, SnakeSettings, _Smoothness, fit_snakes
from sfm.correspondences.outliers import delaunay_neighbours

Floats = NDArray[np.float64]


def normal_matrix(first: Floats, second: Floats, num_frames: int, settings: SnakeSettings) -> Floats:
    """Write the smoothness out as a dense matrix (N T, N T): the plain twin."""
    count = len(first)
    matrix = settings.ridge * np.eye(count * num_frames)
    for i in range(count):
        for k in range(num_frames):
            row = np.zeros((count, num_frames))
            row[i, k] = 2.0
            row[i, [j for j in (k - 1, k + 1) if 0 <= j < num_frames]] = -1.0
            matrix += settings.bending * np.outer(row, row)
    around = delaunay_neighbours(0.5 * (first + second))
    for a, b in {(min(pair), max(pair)) for pair in zip(around.point, around.neighbour, strict=True)}:
        apart = np.sum((0.5 * (first[a] + second[a] - first[b] - second[b])) ** 2)
        unlike = np.sum((second[a] - first[a] - second[b] + first[b]) ** 2)
        weight = settings.coupling / (1 + apart / settings.near_px**2) / (1 + unlike / settings.alike_px**2)
        for k in range(num_frames):
            row = np.zeros((count, num_frames))
            row[a, k], row[b, k] = 1.0, -1.0
            matrix += weight * np.outer(row, row)
    return matrix


def test_conjugate_gradients_solve_the_normal_equations() -> None:
    rng = np.random.default_rng(1)
    first = rng.uniform(0, 100, (12, 2))
    second = first + rng.uniform(-8, 8, (12, 2))
    settings = SnakeSettings()
    weight = rng.random((12, 5)) * (rng.random((12, 5)) < 0.6)
    right = weight[..., None] * rng.uniform(-3, 3, (12, 5, 2))
    found = _Smoothness(first, second, 5, settings).solve(weight, right, np.zeros((12, 5, 2)))
    matrix = normal_matrix(first, second, 5, settings) + np.diag(weight.ravel())
    expected = np.linalg.solve(matrix, right.reshape(-1, 2)).reshape(12, 5, 2)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_neighbours_carry_what_is_not_seen() -> None:
    columns, rows = np.meshgrid(np.arange(5) * 20.0, np.arange(5) * 20.0)
    first = np.column_stack([columns.ravel(), rows.ravel()]) + 30.0
    expected = np.repeat(first[:, None], 3, axis=1)
    shift = np.array([1.5, -1.0])
    seen = np.delete(first, 12, axis=0) + shift
    frames = [ReceivedPoints(seen)] * 3
    snakes = fit_snakes(first, first, expected, frames, SnakeSettings())
    np.testing.assert_allclose(snakes.positions[12, 1] - first[12], shift, atol=0.3)
    assert np.isnan(snakes.received[12]).all()
    assert np.isfinite(np.delete(snakes.received, 12, axis=0)).all()


def test_points_far_away_do_not_pull() -> None:
    first = np.array([[20.0, 20.0], [60.0, 20.0], [40.0, 50.0], [70.0, 70.0]])
    expected = np.repeat(first[:, None], 2, axis=1)
    snakes = fit_snakes(first, first, expected, [ReceivedPoints(first + 9.0)] * 2, SnakeSettings())
    np.testing.assert_array_equal(snakes.positions, expected)
