"""Planes whose bits depend on their neighbours: a proper code, exact decoding, and fewer bits."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.config import CascadeConfig
from dvc.slepian_wolf import NeighbourCoupling, PlaneResult, drive
from dvc.slepian_wolf.cascade.posterior import RangePosterior
from dvc.slepian_wolf.cascade.reconciliation import PlaneReconciliation
from dvc.testing.plane_exchange import Bits, PlaneSource
from tests.coders import SEED, coder_of
from tests.reference.wynerziv_priors import coupled_llr

SETTINGS = CascadeConfig()


def random_coupling(rng: np.random.Generator, shape: tuple[int, int], size: float) -> NeighbourCoupling:
    alone, shift, slope, energy, widening = rng.normal(0.0, size, (5, *shape))
    return NeighbourCoupling(alone, shift, slope, energy**2, widening, rng.normal(0.0, 0.5, 3))


def alike(weight: float, alone: np.ndarray) -> NeighbourCoupling:
    """Return a coupling of bits that are likely as their neighbours are."""
    one, none = np.ones_like(alone), np.zeros_like(alone)
    return NeighbourCoupling(alone, one, -one, none, none, np.array([weight, weight, 0.0]))


def exchange(bits: Bits, llr: np.ndarray, coupling: NeighbourCoupling | None) -> PlaneResult:
    source = PlaneSource(bits[None], coder_of("cascade"))
    plane = PlaneReconciliation(llr, SETTINGS, (0, 0), coupling)
    return drive(plane.decode(RangePosterior(bits.size, SEED)), source.answer)


def smooth_plane(rng: np.random.Generator, shape: tuple[int, int]) -> Bits:
    """Return bits in patches, which are as likely 0 as 1."""
    field = rng.normal(0.0, 1.0, shape)
    for axis in (0, 1):
        field = sum(np.roll(field, step, axis) for step in (-1, 0, 1))
    return (field > 0).astype(np.uint8)


@pytest.mark.parametrize("causal", [False, True])
@pytest.mark.parametrize("shape", [(5, 7), (1, 6), (6, 1), (1, 1)])
def test_neighbours_are_added_as_in_the_plain_way(causal: bool, shape: tuple[int, int]) -> None:
    """Compiled and plain sums agree, on lattices of any shape."""
    rng = np.random.default_rng(3)
    coupling = random_coupling(rng, shape, 1.5)
    belief = rng.integers(0, 2, shape).astype(np.uint8)
    found = (coupling.llr_in_sequence if causal else coupling.llr_given)(belief.ravel())
    wanted = coupled_llr(coupling, belief.astype(np.float64), causal)
    np.testing.assert_allclose(found.reshape(shape), wanted, atol=2e-4)


def test_neighbours_as_expected_tell_nothing() -> None:
    """Beliefs that are those of the bits alone leave all LLRs as they are."""
    coupling = random_coupling(np.random.default_rng(4), (4, 5), 2.0)
    found = coupling.llr_given(coupling.probability_alone.ravel())
    np.testing.assert_allclose(found, coupling.alone.ravel(), atol=1e-5)


def test_lengths_in_sequence_are_those_of_a_code() -> None:
    """The probabilities of all planes sum to one: the ideal code length is one that can be reached."""
    coupling = random_coupling(np.random.default_rng(5), (3, 3), 1.5)
    total = 0.0
    for pattern in itertools.product((0, 1), repeat=9):
        bits = np.array(pattern, np.uint8)
        llr = coupling.llr_in_sequence(bits).astype(np.float64)
        total += float(np.prod(1.0 / (1.0 + np.exp(np.where(bits == 1, llr, -llr)))))
    assert total == pytest.approx(1.0, abs=1e-4)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 10**6), st.floats(0.0, 6.0))
@settings(max_examples=40, deadline=None)
def test_garbage_couplings_end_exactly(rows: int, columns: int, seed: int, size: float) -> None:
    """Couplings that have nothing to do with the bits cost bits; all check bits make sure of the plane."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, rows * columns, dtype=np.uint8)
    coupling = random_coupling(rng, (rows, columns), size)
    source, posterior = PlaneSource(bits[None], coder_of("cascade")), RangePosterior(bits.size, SEED)
    plane = PlaneReconciliation(coupling.alone.ravel(), SETTINGS, (0, 0), coupling)
    drive(plane.decode(posterior), source.answer)
    result = drive(plane.correct(posterior), source.answer)
    np.testing.assert_array_equal(result.bits, bits)
    assert result.parity_bits <= 2 * bits.size


def test_patches_cost_less_by_their_neighbours() -> None:
    """Where bits are alike in patches, neighbours save much of what the bits alone cost."""
    rng = np.random.default_rng(6)
    alone = coupled = ideal = 0.0
    for _ in range(3):
        bits = smooth_plane(rng, (40, 50))
        sign = 1.0 - 2.0 * bits
        llr = rng.normal(1.2 * sign, np.sqrt(2.4))
        results = [exchange(bits.ravel(), llr.ravel(), own) for own in (None, alike(0.9, llr))]
        for result in results:
            np.testing.assert_array_equal(result.bits, bits.ravel())
        alone += results[0].parity_bits + results[0].crc_bits
        coupled += results[1].parity_bits + results[1].crc_bits
        assert results[1].ideal_bits < results[0].ideal_bits
        ideal += results[1].ideal_bits
    assert coupled < 0.92 * alone
    assert coupled < 1.25 * ideal
