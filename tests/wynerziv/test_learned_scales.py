"""Scales learned from what is believed of numbers."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.slepian_wolf.ldpc.belief_propagation import decode_block
from dvc.slepian_wolf.ldpc.graph import SyndromeGraph, syndrome
from dvc.wynerziv import _kernels, quantizer
from dvc.wynerziv.learned_scales import LearnedBand
from tests.slepian_wolf.ldpc.test_belief_propagation import bits_of, words_of

SHAPE = (40, 50)
PLANES = 7
EDGES = quantizer.embedded_edges(3, PLANES, 6.0)


def drawn_band(true: np.ndarray, promised: float, seed: int = 0) -> tuple[LearnedBand, np.ndarray]:
    """Draw coefficients about predictions; return what is believed at first, and their numbers."""
    rng = np.random.default_rng(seed)
    predicted = rng.uniform(-150.0, 150.0, SHAPE)
    numbers = np.searchsorted(EDGES, (predicted + rng.laplace(0.0, 1.0, SHAPE) * true).ravel()) - 1
    scale = np.full(SHAPE, promised)
    numbers = np.clip(numbers, 0, (1 << PLANES) - 1)
    return LearnedBand(EDGES, PLANES, PLANES, predicted, scale, scale), numbers


def certain(band: LearnedBand, numbers: np.ndarray) -> np.ndarray:
    """Return beliefs that know the numbers."""
    priors = band.priors()
    places = numbers - priors.lowest
    believed = np.zeros_like(priors.probabilities)
    among = (places >= 0) & (places < priors.counts)
    believed[np.flatnonzero(among), places[among]] = 1.0
    believed[~among] = priors.probabilities[~among]
    return believed


@pytest.mark.parametrize("promised", [3.0, 10.0, 30.0])
def test_what_is_known_corrects_what_was_promised(promised: float) -> None:
    """Whatever it was."""
    band, numbers = drawn_band(np.full(SHAPE, 10.0), promised)
    for _ in range(3):
        band = band.learn(band.priors(), certain(band, numbers))
    assert band.scale.mean() == pytest.approx(10.0, rel=0.1)


def test_nothing_is_learned_from_nothing() -> None:
    """Beliefs that are the priors leave the scales as they were."""
    band, _ = drawn_band(np.full(SHAPE, 10.0), 12.0)
    priors = band.priors()
    learned = band.learn(priors, priors.probabilities)
    np.testing.assert_allclose(learned.scale, 12.0, rtol=0.03)


def test_places_differ() -> None:
    """Where errors are large around a coefficient its scale is, whatever its own error."""
    true = np.where(np.arange(SHAPE[1]) < 25, 3.0, 24.0) * np.ones(SHAPE)
    band, numbers = drawn_band(true, 9.0)
    for _ in range(3):
        band = band.learn(band.priors(), certain(band, numbers))
    assert band.scale[:, 30:].mean() > 2.0 * band.scale[:, :20].mean()
    changed = numbers.reshape(SHAPE).copy()
    changed[20, 10] += 3
    other = band.learn(band.priors(), certain(band, changed.ravel()))
    same = band.learn(band.priors(), certain(band, numbers))
    ratio = other.scale / same.scale
    assert ratio[20, 10] == pytest.approx(ratio[0, 0])
    assert ratio[20, 11] > 1.1 * ratio[0, 0]


def test_shorter_syndromes_serve_where_scales_are_learned() -> None:
    """Of a band whose error was promised to be three times what it is, and varies from place to place."""
    true = np.where(np.arange(SHAPE[1]) < 25, 4.0, 12.0) * np.ones(SHAPE)
    first, numbers = drawn_band(true, 24.0)
    planes = bits_of(numbers, PLANES)
    words = words_of(planes)
    needed = {}
    for learns in (False, True):
        for length in range(4000, 14000, 500):
            learned, priors = [first], [first.priors()]

            def _learn(beliefs: list) -> list:
                learned[:] = [learned[0].learn(priors[0], beliefs[0])]  # noqa: B023
                priors[:] = [learned[0].priors()]  # noqa: B023
                return priors  # noqa: B023

            graph = SyndromeGraph(numbers.size, tuple(range(PLANES)), length, 1)
            found = decode_block(graph, syndrome(words, graph), priors, _learn if learns else None)
            if found.success and np.array_equal(found.bits, planes):
                needed[learns] = length
                break
    assert needed[True] < 0.93 * needed[False]


@pytest.mark.nojit
def test_kernel_is_its_python() -> None:
    """To the last bit."""
    rng = np.random.default_rng(4)
    borders, lowest = EDGES, np.array([60, 62, 0, 120])
    counts = np.array([5, 3, 8, 8])
    believed = rng.random((4, 8)).astype(np.float32)
    predicted, scale = np.array([-9.0, 4.0, -500.0, 350.0]), np.array([0.01, 5.0, 40.0, 1e5])
    found = []
    for kernel in (_kernels.expected_errors, python_twin(_kernels.expected_errors)):
        errors = np.empty(4)
        kernel(borders, lowest, counts, believed, predicted, scale, errors)
        found.append(errors)
    np.testing.assert_array_equal(*found)
    assert (found[0] > 0).all()
