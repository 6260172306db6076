"""Tests of solving parity equations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc._jit import python_twin
from dvc.slepian_wolf import TurboCode, encode_planes, family
from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.elimination import ordered_statistics, parity_equations, solve
from dvc.slepian_wolf.turbo.interleaver import MAX_SEGMENT_BITS
from tests.reference.turbo_exchange import SEED, Bits, noisy

CODES = (*family("adaptive"), *family("classical"))


def _unpack(equations: np.ndarray, num_bits: int) -> Bits:
    """Unpack equations to one byte per weight."""
    weights: Bits = np.unpackbits(equations.view(np.uint8), axis=1, bitorder="little")[:, :num_bits]
    return weights


@pytest.mark.parametrize("code", CODES, ids=lambda code: code.name)
@pytest.mark.parametrize("num_bits", [1, 63, 64, 130])
def test_equations_are_the_encoder(code: TurboCode, num_bits: int) -> None:
    """The weights, applied to a plane, give its parity."""
    bits = np.random.default_rng(num_bits).integers(0, 2, num_bits, dtype=np.uint8)
    weights = _unpack(parity_equations(code, num_bits, SEED), num_bits)
    np.testing.assert_array_equal(weights @ bits & 1, encode_planes(bits[None], code, SEED)[0])


@given(st.integers(0, 10**6), st.integers(1, 70), st.integers(0, 80), st.sampled_from([0.05, 0.3, 0.5]))
def test_elimination_of_random_equations(seed: int, num_bits: int, num_rows: int, density: float) -> None:
    """All solutions are found: the one returned, and those that differ by a combination of `free`."""
    rng = np.random.default_rng(seed)
    weights = (rng.random((num_rows, num_bits)) < density).astype(np.uint8)
    truth = rng.integers(0, 2, num_bits, dtype=np.uint8)
    padded = np.zeros((num_rows, (num_bits // 64 + 1) * 64), np.uint8)
    padded[:, :num_bits] = weights
    equations = np.packbits(padded, axis=1, bitorder="little").view(np.uint64)
    values = (weights @ truth & 1).astype(np.uint8)
    solution = solve(equations, values, rng.normal(size=num_bits).astype(np.float32))
    assert solution is not None
    np.testing.assert_array_equal(weights @ solution.bits & 1, values)
    assert not (weights.astype(int) @ solution.free.T & 1).any()
    rank_and_free = np.concatenate([solution.free, (solution.bits ^ truth)[None]])
    assert _rank(rank_and_free) == _rank(solution.free) == len(solution.free) == num_bits - _rank(weights)


def _rank(matrix: Bits) -> int:
    """Return the rank over GF(2) by textbook elimination."""
    rows, rank = matrix.copy(), 0
    for column in range(rows.shape[1]):
        pivots = np.flatnonzero(rows[rank:, column])
        if not pivots.size:
            continue
        rows[[rank, rank + pivots[0]]] = rows[[rank + pivots[0], rank]]
        others = np.flatnonzero(rows[:, column])
        rows[others[others != rank]] ^= rows[rank]
        rank += 1
    return rank


@pytest.mark.nojit
def test_contradictions_are_a_value() -> None:
    """Equations without solution give None."""
    equations = np.array([[0b11], [0b110], [0b101]], np.uint64)
    assert solve(equations, np.array([1, 1, 1], np.uint8), np.zeros(3, np.float32)) is None
    assert solve(equations, np.array([1, 1, 0], np.uint8), np.zeros(3, np.float32)) is not None


@pytest.mark.parametrize("code", CODES, ids=lambda code: code.name)
def test_all_parity_nearly_determines_the_plane(code: TurboCode) -> None:
    """N parity bits leave no more bits open than the check bits can settle."""
    equations = parity_equations(code, 500, SEED)
    solution = solve(equations, np.zeros(500, np.uint8), np.ones(500, np.float32))
    assert solution is not None
    assert len(solution.free) <= 6


def test_search_finds_what_iterations_miss() -> None:
    """From the prior alone, ordered statistics correct a few errors of a short plane."""
    code = CODES[0]
    found = 0
    for seed in range(10):
        bits, llr_ch = noisy(np.random.default_rng(seed), 200, 0.01)
        llr = (llr_ch + np.random.default_rng(seed).normal(0, 0.1, 200)).astype(np.float32)
        parity = encode_planes(bits[None], code, SEED)[0, :60]
        planes = ordered_statistics(parity_equations(code, 200, SEED)[:60], parity, llr, llr)
        assert planes is not None
        for plane in planes:
            np.testing.assert_array_equal(encode_planes(plane[None], code, SEED)[0, :60], parity)
        found += any((plane == bits).all() for plane in planes)
    assert found >= 8


@pytest.mark.nojit
def test_compiled_and_interpreted_elimination_agree() -> None:
    """The kernel and its Python source reduce equations in the same way."""
    rows = np.random.default_rng(8).integers(0, 2**63, (30, 1)).astype(np.uint64)
    order = np.random.default_rng(9).permutation(40)
    results = []
    for eliminate in (_kernels.eliminate, python_twin(_kernels.eliminate)):
        work, pivots = rows.copy(), np.empty(40, np.int64)
        results.append((eliminate(work, order, pivots), work, pivots))
    assert results[0][0] == results[1][0] == 30
    np.testing.assert_array_equal(results[0][1], results[1][1])
    np.testing.assert_array_equal(results[0][2], results[1][2])


def test_refuses_divided_planes() -> None:
    """Equations are written for one segment only."""
    with pytest.raises(ValueError, match="one segment"):
        parity_equations(CODES[0], MAX_SEGMENT_BITS + 1, SEED)
