"""What the motion of a frame has in common: shifts, turns and temporal offsets among clutter."""

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.curves import ReceivedPoints, RegistrationSettings, affine_terms, register

Floats = NDArray[np.float64]


def scattered(count: int, seed: int) -> tuple[Floats, Floats]:
    """Draw points of two key frames with parallax."""
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
    found = register(first, second, np.array([1, 2]) / 3, frames, RegistrationSettings())
    error = np.linalg.norm(found - np.stack(truth), axis=2)
    assert np.quantile(error, 0.95) < 0.5


def test_without_points_nothing_deviates() -> None:
    first, second = scattered(20, 2)
    frames = [ReceivedPoints(np.empty((0, 2)))]
    assert not register(first, second, np.array([0.5]), frames, RegistrationSettings()).any()


def test_terms_are_bounded() -> None:
    first, second = scattered(50, 3)
    terms = affine_terms(first, second)
    assert np.abs(terms).max() <= 2.0
    assert affine_terms(first[:1], second[:1]).tolist() == [[1.0, 0.0, 0.0, 0.0, 0.0]]


def test_a_corner_belongs_to_one_place() -> None:
    corners = ReceivedPoints(np.array([[10.0, 10.0], [50.0, 10.0]]))
    chosen, found, distance = corners.match(np.array([[12.0, 10.0], [11.0, 10.0], [55.0, 10.0]]), 3.0)
    assert (chosen.tolist(), found.tolist(), distance.tolist()) == ([1], [0], [1.0])
