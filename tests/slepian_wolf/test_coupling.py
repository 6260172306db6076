"""Planes whose bits depend on their neighbours: a proper code, exact decoding, and fewer bits."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.config import CascadeConfig
from dvc.contracts.test_plane_coders import Bits, PlaneSource
from dvc.slepian_wolf import NeighbourCoupling, PlaneResult, drive
from dvc.slepian_wolf.cascade.cascade_coder import PlaneReconciliation
from dvc.slepian_wolf.cascade.posterior import RangePosterior
from tests.coders import SEED, coder_of
from tests.reference.wynerziv import coupled_llr

SETTINGS = CascadeConfig()


def random_coupling(
    rng: np.random.Generator, shape: tuple[int, int], size: float, share: float = 1.0
) -> NeighbourCoupling:
    """Return a coupling of bits at a share of the places of a lattice, and at one at least."""
    alone, shift, slope, energy, widening = rng.normal(0.0, size, (5, *shape))
    weights = rng.normal(0.0, 0.5, (shape[0], 3))
    places = np.flatnonzero(rng.random(alone.size) < share)
    places = places if places.size else np.array([alone.size - 1])
    return NeighbourCoupling(alone, shift, slope, energy**2, widening, weights, places)


def alike(weight: float, alone: np.ndarray, places: np.ndarray | None = None) -> NeighbourCoupling:
    """Return a coupling of bits that are likely as their neighbours are."""
    one, none = np.ones_like(alone), np.zeros_like(alone)
    weights = np.tile([weight, weight, 0.0], (len(alone), 1))
    places = np.arange(alone.size) if places is None else places
    return NeighbourCoupling(alone, one, -one, none, none, weights, places)


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


@pytest.mark.parametrize("share", [1.0, 0.6])
@pytest.mark.parametrize("causal", [False, True])
@pytest.mark.parametrize("shape", [(5, 7), (1, 6), (6, 1), (1, 1)])
def test_neighbours_are_added_as_in_the_plain_way(causal: bool, shape: tuple[int, int], share: float) -> None:
    """Compiled and plain sums agree, on lattices of any shape; places without a bit tell nothing."""
    rng = np.random.default_rng(3)
    coupling = random_coupling(rng, shape, 1.5, share)
    belief = rng.integers(0, 2, shape).astype(np.uint8)
    found = coupling.llr_given(belief.ravel()[coupling.places], causal)
    wanted = coupled_llr(coupling, belief.astype(np.float64), causal)
    np.testing.assert_allclose(found, wanted.ravel()[coupling.places], atol=2e-4)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_neighbours_as_expected_tell_nothing(share: float) -> None:
    coupling = random_coupling(np.random.default_rng(4), (4, 5), 2.0, share)
    found = coupling.llr_given(coupling.base_probability.ravel()[coupling.places], causal=False)
    np.testing.assert_allclose(found, coupling.base.ravel()[coupling.places], atol=1e-5)


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_lengths_in_sequence_are_those_of_a_code(share: float) -> None:
    """The probabilities of all planes sum to one: the ideal code length is one that can be reached."""
    coupling = random_coupling(np.random.default_rng(5), (3, 3), 1.5, share)
    total = 0.0
    for pattern in itertools.product((0, 1), repeat=coupling.places.size):
        bits = np.array(pattern, np.uint8)
        llr = coupling.llr_given(bits, causal=True).astype(np.float64)
        total += float(np.prod(1.0 / (1.0 + np.exp(np.where(bits == 1, llr, -llr)))))
    assert total == pytest.approx(1.0, abs=1e-4)


@given(
    st.integers(1, 6), st.integers(1, 6), st.integers(1, 4), st.sampled_from([0.2, 0.7, 1.0]), st.booleans(),
    st.integers(0, 10**6),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_stacked_lattices_do_not_depend_on_each_other(
    rows: int, columns: int, count: int, share: float, causal: bool, seed: int
) -> None:
    """Bits of several lattices in one run have the LLRs that each lattice alone gives, to the last bit."""
    rng = np.random.default_rng(seed)
    parts = [random_coupling(rng, (rows, columns), 1.5, share) for _ in range(count)]
    beliefs = [rng.integers(0, 2, part.places.size, dtype=np.uint8) for part in parts]
    stacked = NeighbourCoupling.stacked(parts)
    assert stacked.places.size == sum(part.places.size for part in parts)
    together = stacked.llr_given(np.concatenate(beliefs), causal)
    alone = [part.llr_given(belief, causal) for part, belief in zip(parts, beliefs, strict=True)]
    np.testing.assert_array_equal(together, np.concatenate(alone))
    np.testing.assert_array_equal(
        stacked.base.ravel()[stacked.places],
        np.concatenate([part.base.ravel()[part.places] for part in parts]),
    )


@given(
    st.integers(1, 9), st.integers(1, 9), st.integers(0, 10**6), st.floats(0.0, 6.0), st.floats(0.1, 1.0),
    st.integers(1, 3),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_garbage_couplings_end_exactly(
    rows: int, columns: int, seed: int, size: float, share: float, count: int
) -> None:
    """Couplings that have nothing to do with the bits cost bits; all check bits make sure of the plane."""
    rng = np.random.default_rng(seed)
    parts = [random_coupling(rng, (rows, columns), size, share) for _ in range(count)]
    coupling = NeighbourCoupling.stacked(parts)
    bits = rng.integers(0, 2, coupling.places.size, dtype=np.uint8)
    source, posterior = PlaneSource(bits[None], coder_of("cascade")), RangePosterior(bits.size, SEED)
    plane = PlaneReconciliation(coupling.base.ravel()[coupling.places], SETTINGS, (0, 0), coupling)
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


def test_runs_of_several_planes_gain_by_neighbours_too() -> None:
    """Two planes of which only a square is wanted are one run, in which neighbours tell as much."""
    rng = np.random.default_rng(7)
    shape = 40, 50
    inside = np.zeros(shape, bool)
    inside[4:32, 8:44] = True
    places = np.flatnonzero(inside)
    planes = [smooth_plane(rng, shape) for _ in range(2)]
    llrs = [rng.normal(1.2 * (1.0 - 2.0 * bits), np.sqrt(2.4)) for bits in planes]
    bits, llr = (np.concatenate([own[inside] for own in several]) for several in (planes, llrs))
    stacked = NeighbourCoupling.stacked([alike(0.9, own, places) for own in llrs])
    alone, coupled = (exchange(bits, llr, coupling) for coupling in (None, stacked))
    for result in (alone, coupled):
        np.testing.assert_array_equal(result.bits, bits)
    assert coupled.ideal_bits < alone.ideal_bits
    assert coupled.parity_bits + coupled.crc_bits < 0.92 * (alone.parity_bits + alone.crc_bits)
