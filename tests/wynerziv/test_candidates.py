"""Priors of numbers: those of the Laplacian in every bin near the prediction."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.slepian_wolf.ldpc.belief_propagation import NumberPriors
from dvc.wynerziv import _kernels, quantizer
from dvc.wynerziv.candidates import credible_intervals, number_priors
from dvc.wynerziv.noise import OUTLIER_PROBABILITY, interval_probability

STEP, PLANES = 12.0, 6


@pytest.mark.parametrize("band", [0, 3])
@pytest.mark.parametrize("depth", [1, 3, 6])
def test_probabilities_are_those_of_the_intervals(band: int, depth: int) -> None:
    """Each candidate has the share of its bin in all candidates, without that of outliers."""
    rng = np.random.default_rng(depth)
    edges = quantizer.embedded_edges(band, PLANES, STEP)
    predicted = rng.uniform(edges[0] - 30.0, edges[-1] + 30.0, 50)
    scale = rng.uniform(0.3, 20.0, 50)
    priors = number_priors(edges, PLANES, depth, predicted, scale)
    borders = edges[:: 1 << (PLANES - depth)]
    for n in range(50):
        own = np.arange(priors.lowest[n], priors.lowest[n] + priors.counts[n])
        assert 0 <= own[0] <= own[-1] < 1 << depth
        nearest = int(np.clip(np.searchsorted(borders, predicted[n]) - 1, 0, (1 << depth) - 1))
        assert own[0] <= nearest <= own[-1]
        lower, upper = borders[own], borders[own + 1]
        mass = np.maximum(
            interval_probability(lower, upper, np.full(own.size, predicted[n]), np.full(own.size, scale[n])),
            1e-12,
        )
        np.testing.assert_allclose(
            priors.probabilities[n, : own.size],
            (1 - OUTLIER_PROBABILITY) * mass / mass.sum(),
            rtol=1e-6,
            atol=1e-11,
        )


def test_ideal_code_length() -> None:
    """That of a candidate, and of an outlier."""
    edges = quantizer.embedded_edges(0, PLANES, STEP)
    priors = number_priors(edges, PLANES, PLANES, np.array([100.0]), np.array([0.5]))
    likely = int(100.0 / STEP)
    expected = -np.log2(priors.probabilities[0, likely - priors.lowest[0]] + OUTLIER_PROBABILITY / 64)
    assert priors.ideal_bits(np.array([likely])) == pytest.approx(expected, rel=1e-3)
    assert priors.ideal_bits(np.array([60])) == pytest.approx(-np.log2(OUTLIER_PROBABILITY / 64), rel=1e-6)


@pytest.mark.nojit
def test_kernel_is_its_python() -> None:
    """To the last bit."""
    borders = quantizer.embedded_edges(3, 4, 9.0)
    predicted, scale = np.linspace(-80.0, 80.0, 21), np.linspace(0.3, 40.0, 21)
    found = []
    for kernel in (_kernels.candidates, python_twin(_kernels.candidates)):
        bins, probabilities = np.zeros((2, 21), np.int64), np.zeros((21, 11), np.float32)
        kernel(borders, predicted, scale, 11.5, 5, 0.99, bins, probabilities)
        found.append((bins, probabilities))
    for ours, twins in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, twins)


def test_credible_intervals_hold_what_is_likely() -> None:
    """One bin where a number is certain, several where it is not; without what is unlikely on either side."""
    edges = quantizer.embedded_edges(3, PLANES, STEP)
    borders = edges[::2]
    lowest, counts = np.array([4, 10, 20, 0]), np.array([3, 4, 4, 2])
    probabilities = np.zeros((4, 4), np.float32)
    priors = NumberPriors(PLANES - 1, lowest, counts, probabilities, OUTLIER_PROBABILITY)
    believed = np.array(
        [[0.0, 1.0, 0.0, 0.0], [0.04, 0.5, 0.42, 0.04], [0.25, 0.25, 0.25, 0.25], [1.0, 0.0, 0.0, 0.0]],
        np.float32,
    )
    lower, upper = credible_intervals(edges, PLANES, priors, believed)
    assert lower.tolist() == borders[[5, 11, 20, 0]].tolist()
    assert upper.tolist() == borders[[6, 13, 24, 1]].tolist()
