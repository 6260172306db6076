"""What more planes are worth: against numeric integration of the densities."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.wynerziv import _kernels, noise, quantizer
from dvc.wynerziv.refinement import OUTLIER_PROBABILITY, expected_refinement

PLANES, STEP = 7, 10.0
EDGES = quantizer.embedded_edges(1, PLANES, STEP)
RESOLUTION = 4096


def coefficients(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bins, predictions and scales; a few predictions are far off."""
    rng = np.random.default_rng(seed)
    predicted = rng.normal(0.0, 60.0, count)
    scale = np.clip(np.exp(rng.normal(1.0, 1.0, count)), noise.MIN_SCALE, None)
    truth = predicted + rng.laplace(0.0, 1.0, count) * scale + 200.0 * (rng.random(count) < 0.1)
    bins = np.floor(truth / STEP + quantizer.embedded_origin(1, PLANES)).astype(np.int64)
    return np.clip(bins, 0, 2**PLANES - 1), predicted, scale


def integrated(lower: float, upper: float, predicted: float, scale: float, depth: int) -> np.ndarray:
    """Return entropy and lost variance of 1 to `depth` halvings of an interval, by sums over fine steps."""
    ends = np.linspace(lower, upper, RESOLUTION + 1)
    centres = (ends[1:] + ends[:-1]) / 2
    below, above = np.minimum(ends - predicted, 0.0), np.maximum(ends - predicted, 0.0)
    mass = 0.5 * (np.diff(np.exp(below / scale)) - np.diff(np.exp(-above / scale)))
    farther = np.exp(-max(lower - predicted, predicted - upper, 0.0) / scale)  # probability of such errors
    mass += (OUTLIER_PROBABILITY * farther + 1e-12) / RESOLUTION
    mass /= mass.sum()
    variance = np.sum(mass * (centres - np.sum(mass * centres)) ** 2)
    found = []
    for halvings in range(1, depth + 1):
        parts, points = mass.reshape(2**halvings, -1), centres.reshape(2**halvings, -1)
        shares = parts.sum(axis=1)
        means = np.sum(parts * points, axis=1) / shares
        within = np.sum(parts * (points - means[:, None]) ** 2)
        found.append((-np.sum(shares * np.log2(shares)), variance - within))
    return np.array(found)


@pytest.mark.parametrize("known", [0, 2, 4, 6])
def test_entropy_and_saving_are_those_of_the_density(known: int) -> None:
    """They agree with integration for each coefficient, near the prediction and far out in the tails."""
    bins, predicted, scale = coefficients(60)
    missing = PLANES - known
    prefix, depth = bins >> missing, min(missing, 2)
    expected = [
        integrated(EDGES[p << missing], EDGES[(p + 1) << missing], y, b, depth)
        for p, y, b in zip(prefix, predicted, scale, strict=True)
    ]
    worth = expected_refinement(prefix, missing, EDGES, predicted, scale, depth)
    bits, saved = np.moveaxis(expected, 0, -1).swapaxes(0, 1)
    np.testing.assert_allclose(worth.bits, bits, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(worth.saved, saved, rtol=1e-3, atol=1e-3)


def test_every_coefficient_stands_for_itself() -> None:
    """What is expected of one does not depend on those beside it."""
    prefix, predicted, scale = coefficients(50)
    together = expected_refinement(prefix >> 2, 2, EDGES, predicted, scale, 2)
    assert together.bits.shape == together.saved.shape == (2, 50)
    for n in range(50):
        own = slice(n, n + 1)
        alone = expected_refinement(prefix[own] >> 2, 2, EDGES, predicted[own], scale[own], 2)
        np.testing.assert_array_equal(alone.bits, together.bits[:, own])
        np.testing.assert_array_equal(alone.saved, together.saved[:, own])


def test_sure_planes_are_worth_nothing() -> None:
    """Where the prediction is known to lie well within a half, neither bits nor error are to be expected."""
    prefix, scale = np.zeros(100, np.int64), np.full(100, noise.MIN_SCALE)
    worth = expected_refinement(prefix, 1, np.array([0.0, 50.0, 100.0]), np.full(100, 20.0), scale, 1)
    assert worth.bits.max() < 0.002
    assert worth.saved.max() < 100**2 * OUTLIER_PROBABILITY


def test_bins_that_do_not_exist_count_nothing() -> None:
    """An interval without width, as planes of a range quantiser may spell, has nothing to tell."""
    edges = quantizer.bin_edges(8, 3.0)
    worth = expected_refinement(np.array([7]), 0, edges, np.zeros(1), np.ones(1), 0)
    assert worth.bits.size == worth.saved.size == 0
    worth = expected_refinement(np.array([3]), 1, edges, np.array([10.0]), np.ones(1), 1)
    assert worth.bits.shape == (1, 1)
    assert worth.bits[0, 0] < 1e-3


@pytest.mark.nojit
def test_kernel_equals_its_twin() -> None:
    """Compiled and as Python, to the last bit: requests depend on it."""
    bins, predicted, scale = coefficients(40, seed=1)
    results = []
    for function in (_kernels.refinement, python_twin(_kernels.refinement)):
        bits, saved = np.zeros((2, 2, bins.size))
        function(bins >> 3, 3, EDGES, predicted, scale, 2e-4, bits, saved)
        results.append((bits.tolist(), saved.tolist()))
        assert bits.min() >= 0.0
        assert saved.min() >= 0.0
        assert bits.sum(axis=1).min() > 0.0
        assert saved.sum(axis=1).min() > 0.0
    assert results[0] == results[1]
