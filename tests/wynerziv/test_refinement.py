"""What more planes are worth: against numeric integration of the densities."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.wynerziv import _kernels, noise, quantizer
from dvc.wynerziv.refinement import NUM_SAMPLES, expected_refinement

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
    mass = np.exp(-np.abs(centres - predicted) / scale) / (2 * scale) * (upper - lower) / RESOLUTION
    mass += (noise.OUTLIER_PROBABILITY * mass.sum() + 1e-12) / RESOLUTION
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
    """Sums over a band agree with integration, near the prediction and far out in the tails."""
    bins, predicted, scale = coefficients(60)
    missing = PLANES - known
    prefix, depth = bins >> missing, min(missing, 2)
    expected = sum(
        integrated(EDGES[p << missing], EDGES[(p + 1) << missing], y, b, depth)
        for p, y, b in zip(prefix, predicted, scale, strict=True)
    )
    worth = expected_refinement(prefix, missing, EDGES, predicted, scale, depth)
    np.testing.assert_allclose(worth.bits, expected[:, 0], rtol=5e-3, atol=5e-3)
    np.testing.assert_allclose(worth.saved, expected[:, 1], rtol=1e-2, atol=1e-2)


def test_every_so_many_coefficients_of_a_large_band_are_looked_at() -> None:
    """They stand for all."""
    prefix, predicted, scale = coefficients(3 * NUM_SAMPLES)
    few = expected_refinement(prefix[::3], 1, EDGES, predicted[::3], scale[::3], 1)
    found = expected_refinement(prefix, 1, EDGES, predicted, scale, 1)
    np.testing.assert_allclose(found, 3.0 * np.array(few), rtol=1e-12)


def test_sure_planes_are_worth_nothing() -> None:
    """Where the prediction is known to lie well within a half, neither bits nor error are to be expected."""
    prefix, scale = np.zeros(100, np.int64), np.full(100, noise.MIN_SCALE)
    worth = expected_refinement(prefix, 1, np.array([0.0, 50.0, 100.0]), np.full(100, 20.0), scale, 1)
    assert worth.bits[0] < 0.2
    assert worth.saved[0] < 100.0 * 100**2 * noise.OUTLIER_PROBABILITY


def test_bins_that_do_not_exist_count_nothing() -> None:
    """An interval without width, as planes of a range quantiser may spell, has nothing to tell."""
    edges = quantizer.bin_edges(8, 3.0)
    worth = expected_refinement(np.array([7]), 0, edges, np.zeros(1), np.ones(1), 0)
    assert worth.bits.size == worth.saved.size == 0
    worth = expected_refinement(np.array([3]), 1, edges, np.array([10.0]), np.ones(1), 1)
    assert worth.bits[0] < 1e-3


@pytest.mark.nojit
def test_kernel_equals_its_twin() -> None:
    """Compiled and as Python, to the last bit: requests depend on it."""
    bins, predicted, scale = coefficients(40, seed=1)
    sums = []
    for function in (_kernels.refinement, python_twin(_kernels.refinement)):
        found = np.zeros((2, 2), np.int64)
        function(bins >> 3, 3, EDGES, predicted, scale, 2e-4, 2.0**20, found)
        sums.append(found.tolist())
    assert sums[0] == sums[1]
    assert min(sums[0][0]) > 0
