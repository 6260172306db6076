"""Beliefs of errors: exact in one order, and the same from kernels and from their Python."""

import itertools

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.config import CascadeConfig
from dvc.slepian_wolf.cascade import _kernels, posterior
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.cascade.posterior import NUM_ORDERS, RangePosterior, bit_order
from dvc.slepian_wolf.coupling import NeighbourCoupling, bounded_llr
from tests.reference.slepian_wolf import Range, exact_odds, probability_odd

SEED = 1


def started(num_bits: int, seed: int) -> tuple[RangePosterior, np.ndarray, np.ndarray]:
    """Return beliefs of a random plane, the plane, and its prior odds of errors."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    llr = rng.normal(0.0, 3.0, num_bits).astype(np.float32)
    beliefs = RangePosterior(num_bits, SEED)
    beliefs.start(llr)
    return beliefs, bits, np.exp(-np.abs(llr.astype(np.float64)))


def tell(beliefs: RangePosterior, bits: np.ndarray, order: int, *positions: int) -> None:
    """Answer with the parities of a plane."""
    parities = np.bitwise_xor.accumulate(bits[bit_order(order, bits.size, SEED)])[list(positions)]
    beliefs.add_answers(order, np.array(positions), parities)


def random_coupling(
    rng: np.random.Generator, shape: tuple[int, int], size: float, llr: np.ndarray
) -> NeighbourCoupling:
    """Return a coupling of any bits that have these LLRs alone, at some places of a lattice or at all."""
    alone, shift, slope, energy, widening = rng.normal(0.0, size, (5, *shape))
    places = np.sort(rng.permutation(alone.size)[: llr.size])
    alone.ravel()[places] = llr
    weights = rng.normal(0.0, 0.3, (shape[0], 3))
    return NeighbourCoupling(alone, shift, slope, energy**2, widening, weights, places)


def ranges_of(bits: np.ndarray, llr_sign: np.ndarray, order: int, *ends: int) -> list[Range]:
    """Return the ranges of an order that end at some positions, with the parities of their errors."""
    whole = bit_order(order, bits.size, SEED)
    errors = bits ^ llr_sign
    edges = [-1, *ends]
    known = []
    for before, end in itertools.pairwise(edges):
        own = whole[before + 1 : end + 1]
        known.append((own, int(errors[own].sum() % 2)))
    return known


@pytest.mark.parametrize("seed", range(6))
def test_one_order_is_exact(seed: int) -> None:
    beliefs, bits, prior = started(10, seed)
    first = beliefs.decisions
    tell(beliefs, bits, 0, 4, 9)
    tell(beliefs, bits, 0, 1, 6)
    beliefs.propagate(10, 0.0)
    expected = exact_odds(prior, ranges_of(bits, first, 0, 1, 4, 6, 9))
    np.testing.assert_allclose(beliefs.odds, expected, rtol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_orders_pass_on_what_they_know(seed: int) -> None:
    """Of three bits one order tells the first, another the second: the third follows from the whole."""
    beliefs, bits, _ = started(3, seed)
    errors = beliefs.decisions ^ bits
    tell(beliefs, bits, 0, 0, 2)
    tell(beliefs, bits, 1, 0)
    beliefs.propagate(100, 0.0)
    np.testing.assert_array_equal(beliefs.odds > 1e4, errors)
    np.testing.assert_array_equal(beliefs.odds < 1e-4, 1 - errors)


@pytest.mark.parametrize("seed", range(6))
def test_division_is_the_fairest_one(seed: int) -> None:
    """A range is divided where the parity of its first part is the nearest to a fair coin."""
    beliefs, bits, prior = started(9, seed)
    first = beliefs.decisions
    tell(beliefs, bits, 0, 8)
    beliefs.propagate(4, 0.0)
    ((order, (position,)),) = beliefs.divisions(1.0)[0]
    known = ranges_of(bits, first, 0, 8)
    whole = bit_order(0, 9, SEED)
    biases = [abs(2 * probability_odd(prior, known, whole[: cut + 1]) - 1) for cut in range(8)]
    assert order == 0
    assert biases[position] == pytest.approx(min(biases), abs=1e-6)


def test_first_ranges_are_as_fair_as_asked() -> None:
    """Ranges of a new order hold as many bits as bring the bias of their parity below the bound."""
    beliefs = RangePosterior(3000, SEED)
    llr = np.full(3000, 3.0, np.float32)
    beliefs.start(llr)
    ((order, positions),) = beliefs.new_order(0.2)
    soft = np.tanh(1.5)
    expected = int(np.ceil(np.log(0.2) / np.log(soft)))
    assert order == 0
    assert positions[-1] == 2999  # the parity of the whole plane
    np.testing.assert_array_equal(np.diff(positions[:-1]), expected)


def test_what_is_missing_comes_from_the_next_order() -> None:
    """Where divisions tell less than is wanted, ranges of the next order are added, and later the rest."""
    beliefs, bits, _ = started(400, 3)
    assert not beliefs.batch(1.0, 0.36, 0.2)  # no order is in use
    ((order, positions),) = beliefs.new_order(0.2)
    tell(beliefs, bits, order, *positions)
    beliefs.propagate(10, 0.01)
    ((_, divisions),) = beliefs.batch(0.0, 0.36, 0.2)
    unknown = _kernels.uncertainty_bits(beliefs.odds) + posterior.MORE_BITS
    share = (divisions.size + 3.0) / unknown
    (first, same), (second, some) = beliefs.batch(share, 0.36, 0.2)
    assert (first, second) == (0, 1)
    np.testing.assert_array_equal(same, divisions)
    assert 3 <= some.size < 8
    tell(beliefs, bits, first, *same)
    tell(beliefs, bits, second, *some)
    beliefs.propagate(10, 0.01)
    assert all(order == 0 or own.max() <= some[-1] for order, own in beliefs.divisions(1.0)[0])
    ((order, rest),) = beliefs.new_order(0.2)
    assert order == 1
    assert rest.min() > some[-1]


@pytest.mark.parametrize("probability", [0.5, 0.1, 0.01, 0.001])
def test_uncertainty_is_near_the_entropy(probability: float) -> None:
    odds = np.full(50, probability / (1.0 - probability))
    entropy = -50.0 * (probability * np.log2(probability) + (1 - probability) * np.log2(1 - probability))
    assert 0.85 < _kernels.uncertainty_bits(odds) / entropy < 1.5
    assert _kernels.uncertainty_bits(np.ones(50)) == 50.0


def test_residual_errors_count_pairs_that_no_parity_shows() -> None:
    """Pairs of bits in the same ranges of all orders are the errors that are left; others are none."""
    beliefs = RangePosterior(64, SEED)
    llr = np.full(64, 6.0, np.float32)
    beliefs.start(llr)
    bits = np.zeros(64, np.uint8)
    tell(beliefs, bits, 0, 31, 63)
    beliefs.propagate(10, 0.0)
    pairs = 2 * (32 * 31 / 2) * np.exp(-12.0)
    assert beliefs.residual_errors() - beliefs.expected_errors == pytest.approx(pairs, rel=1e-4)
    tell(beliefs, bits, 1, 31)
    beliefs.propagate(10, 0.0)
    orders = [bit_order(k, 64, SEED) for k in (0, 1)]
    halves = [{int(bit) for bit in own[part]} for own in orders for part in (slice(32), slice(32, 64))]
    sizes = [len(a & b) for a in halves[:2] for b in halves[2:]]
    pairs = sum(n * (n - 1) / 2 for n in sizes) * np.exp(-12.0)
    assert beliefs.residual_errors() - beliefs.expected_errors == pytest.approx(pairs, rel=1e-4)


def test_prior_learns_how_many_errors_there_are() -> None:
    """Where parities show five times the errors that were expected, all odds become greater."""
    rng = np.random.default_rng(3)
    num_bits = 2000
    bits = (rng.random(num_bits) < 0.05).astype(np.uint8)
    beliefs = RangePosterior(num_bits, SEED)
    beliefs.start(np.full(num_bits, 4.6, np.float32))
    tell(beliefs, bits, 0, *range(19, num_bits, 20))
    beliefs.propagate(4, 0.0)
    before = beliefs.expected_errors
    while beliefs.rescale():
        beliefs.propagate(4, 0.0)
    assert beliefs.expected_errors > 1.2 * before


@pytest.mark.parametrize("shape", [(20, 30), (31, 29)])
def test_priors_follow_neighbours(shape: tuple[int, int]) -> None:
    """Priors are those of LLRs with neighbours added, but for less than a change that is used."""
    rng = np.random.default_rng(4)
    bits = rng.integers(0, 2, 600, dtype=np.uint8)
    llr = (rng.normal(2.0, 2.0, 600) * (1 - 2.0 * bits)).astype(np.float32)
    coupling = random_coupling(rng, shape, 1.0, llr)
    beliefs = RangePosterior(600, SEED)
    beliefs.start(bounded_llr(llr), coupling)
    decided = beliefs.decisions
    tell(beliefs, bits, 0, *range(4, 600, 5))
    for turn in range(3):
        beliefs.propagate(10, 0.01)
        odds = beliefs.odds.copy()
        believed = np.where(decided, 1.0 / (1.0 + odds), odds / (1.0 + odds))
        assert beliefs.couple() or turn
        prior = beliefs._beliefs.prior.copy()
        wanted = np.abs(
            bounded_llr(coupling.llr_given(believed, causal=False)) - np.where(decided, 1, -1) * np.log(prior)
        )
        assert np.quantile(wanted, 0.9) < 0.05
        assert wanted.max() < posterior.MIN_COUPLED_CHANGE + 0.02
        first = np.sum(prior / (1.0 + prior))
        assert beliefs._expected == pytest.approx(first, rel=1e-6)


@pytest.mark.parametrize(("odds", "is_satisfied"), [(0.9, True), (1.1, False)])
def test_bits_that_are_likelier_wrong_than_right_count_as_errors(odds: float, is_satisfied: bool) -> None:
    beliefs, _, _ = started(8, 0)
    tell(beliefs, beliefs.decisions, 0, 3)
    assert beliefs.is_satisfied()
    beliefs.odds[5] = odds
    assert beliefs.is_satisfied() == is_satisfied


@pytest.mark.nojit
@pytest.mark.parametrize("shape", [(10, 20), (13, 24)])
def test_kernels_equal_their_twins(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    """Compiled and as Python, a plane is asked for the same and believed the same, to the last bit."""
    rng = np.random.default_rng(5)
    num_bits = 200
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    llr = (rng.normal(2.0, 2.0, num_bits) * (1 - 2.0 * bits)).astype(np.float32)
    coupling = random_coupling(rng, shape, 1.0, llr)

    @np.errstate(over="ignore")  # hashes wrap around, of which plain Python warns
    def course() -> list[object]:
        beliefs = RangePosterior(num_bits, SEED)
        beliefs.start(llr, coupling)
        log: list[object] = []
        for _ in range(12):
            log.append((beliefs.propagate(3, 0.02), beliefs.couple()))
            question = beliefs.divisions(0.4)[0] or beliefs.new_order(0.3) or beliefs.best_divisions()
            if not question:
                break
            ((order, positions),) = question
            log.append((order, positions.tolist()))
            tell(beliefs, bits, order, *positions.tolist())
            log.append(beliefs.rescale())
            log.append((beliefs.residual_errors(), beliefs.is_satisfied(), beliefs.odds.tolist()))
        return log

    compiled = course()
    for name in dir(_kernels):
        function = getattr(_kernels, name)
        if hasattr(function, "py_func"):
            monkeypatch.setattr(posterior._kernels, name, python_twin(function))
    with np.errstate(all="ignore"):
        assert course() == compiled
    assert len(compiled) > 10


@pytest.mark.parametrize("num_bits", [1, 2, 3, 64, 65, 100, 127, 128, 1000])
def test_orders_are_permutations_and_words_hold_all_planes(num_bits: int) -> None:
    """Every order has each bit once, and words carry 64 planes at once."""
    orders = np.stack([bit_order(number, num_bits, 7) for number in range(NUM_ORDERS)])
    if num_bits > 50:
        assert len({tuple(order) for order in orders.tolist()}) == NUM_ORDERS
    np.testing.assert_array_equal(np.sort(orders, axis=1), np.tile(np.arange(num_bits), (NUM_ORDERS, 1)))
    rng = np.random.default_rng(0)
    words = rng.integers(0, 2**64, num_bits, dtype=np.uint64)
    parities = np.empty_like(words)
    CascadeCoder(CascadeConfig(), 7).encode(3, words, parities)
    for plane in (0, 17, 63):
        plane_bits = (words >> np.uint64(plane)) & np.uint64(1)
        expected = np.cumsum(plane_bits[orders[3]]) % 2
        np.testing.assert_array_equal((parities >> np.uint64(plane)) & np.uint64(1), expected)


@pytest.mark.parametrize("num_bits", [33, 50, 63])
def test_orders_are_those_of_the_next_power_of_two(num_bits: int) -> None:
    for number in range(NUM_ORDERS):
        whole = bit_order(number, 64, SEED)
        wanted = [bit for bit in whole.tolist() if bit < num_bits]
        assert bit_order(number, num_bits, SEED).tolist() == wanted


@pytest.mark.nojit
@pytest.mark.parametrize("num_bits", [1, 37, 64])
def test_prefix_parities_equal_their_twin(num_bits: int) -> None:
    words = np.random.default_rng(2).integers(0, 2**64, num_bits, dtype=np.uint64)
    found = np.empty_like(words)
    python_twin(_kernels.prefix_parities)(words, bit_order(5, 64, SEED), found)
    expected = np.bitwise_xor.accumulate(words[bit_order(5, 64, SEED)[bit_order(5, 64, SEED) < num_bits]])
    np.testing.assert_array_equal(found, expected)
    _kernels.prefix_parities(words, bit_order(5, 64, SEED), found)
    np.testing.assert_array_equal(found, expected)


def test_orders_are_fetched_as_they_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    fetched: list[int] = []

    def counting(number: int, num_bits: int, seed: int) -> np.ndarray:
        fetched.append(number)
        return bit_order(number, num_bits, seed)

    monkeypatch.setattr(posterior, "bit_order", counting)
    beliefs, bits, _ = started(300, 2)
    assert not fetched
    ((order, positions),) = beliefs.new_order(0.2)
    assert fetched == [0]
    tell(beliefs, bits, order, *positions.tolist())
    tell(beliefs, bits, 1, 149)
    assert beliefs.new_order(0.2)
    assert fetched == [0, 1, 2]
    beliefs.start(np.full(300, 3.0, np.float32))
    assert beliefs.new_order(0.2)
    assert fetched == [0, 1, 2]
