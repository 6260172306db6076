"""Tests of iterative decoding."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.contracts.test_plane_coders import noisy
from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.turbo_decoder import LaneDecoder, TurboDecoder, bcjr_recursions, lane_layout, siso
from dvc.slepian_wolf.turbo.turbo_encoder import CLASSICAL, encode_planes, trellis
from tests.coders import SEED
from tests.reference.turbo_bcjr import bcjr, rsc_encode


def _crossover(entropy: float) -> float:
    """Invert the binary entropy by bisection."""
    low, high = 1e-6, 0.5
    for _ in range(60):
        p = (low + high) / 2
        if -p * np.log2(p) - (1 - p) * np.log2(1 - p) < entropy:
            low = p
        else:
            high = p
    return low


@pytest.mark.parametrize("entropy", [0.06, 0.2, 0.5])
def test_corrects_its_channel(entropy: float) -> None:
    """With enough parity for a channel, decoding succeeds."""
    bits, llr_ch = noisy(np.random.default_rng(4), 1584, _crossover(entropy))
    parity = encode_planes(bits[None], CLASSICAL, SEED)[0]
    decoder = TurboDecoder(CLASSICAL, 1584, SEED)
    decoder.start(llr_ch)
    decoder.add_parity(parity[: min(1584, round((2.5 if entropy < 0.13 else 1.6) * entropy * 1584))])
    assert not decoder.parity_satisfied
    assert decoder.iterate(60) < 60
    assert decoder.parity_satisfied
    np.testing.assert_array_equal(decoder.decisions, bits)
    decoder.polish(5)
    assert decoder.expected_errors < 1


def test_goes_on_when_parity_arrives() -> None:
    """Parity that comes in pieces ends in the same decisions, and a restart repeats every number."""
    bits, llr_ch = noisy(np.random.default_rng(5), 1584, 0.07)
    parity = encode_planes(bits[None], CLASSICAL, SEED)[0]
    decoder = TurboDecoder(CLASSICAL, 1584, SEED)
    runs = []
    for _ in range(2):
        decoder.start(llr_ch)
        trace = []
        for first in range(0, 900, 100):
            decoder.add_parity(parity[first : first + 100])
            trace.append(decoder.iterate(5))
        runs.append((trace, decoder.decisions.copy()))
        assert decoder.num_parity == 900
        np.testing.assert_array_equal(decoder.decisions, bits)
    assert runs[0][0] == runs[1][0]
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


@pytest.mark.parametrize("bit", [0, 1])
def test_constant_planes(bit: int) -> None:
    """Planes of zeros and of ones are planes like others."""
    bits = np.full(300, bit, np.uint8)
    decoder = TurboDecoder(CLASSICAL, 300, SEED)
    decoder.start(np.where(np.random.default_rng(1).random(300) < 0.1, -2.2, 2.2) * (1 - 2 * bit))
    decoder.add_parity(encode_planes(bits[None], CLASSICAL, SEED)[0, :240])
    decoder.iterate(40)
    np.testing.assert_array_equal(decoder.decisions, bits)


def test_refuses_bad_arguments() -> None:
    """LLRs and parity are checked for shape and value."""
    decoder = TurboDecoder(CLASSICAL, 20, SEED)
    with pytest.raises(ValueError, match="20 numbers"):
        decoder.start(np.zeros(19))
    with pytest.raises(ValueError, match="20 numbers"):
        decoder.start(np.full(20, np.nan))
    decoder.start(np.full(20, np.inf))
    with pytest.raises(ValueError, match="at most 20"):
        decoder.add_parity(np.zeros(21, np.uint8))
    decoder.add_parity(np.zeros(4, np.uint8))
    with pytest.raises(ValueError, match="at most 16"):
        decoder.add_parity(np.zeros(17, np.uint8))
    with pytest.raises(ValueError, match="0 and 1"):
        decoder.add_parity(np.full(3, 2, np.uint8))


POLYNOMIALS = [
    (0b11, 0b01),
    (0b111, 0b101),
    (0b101, 0b111),
    (0b1101, 0b1011),
    (0b1011, 0b1101),
    (0b11001, 0b11011),
]


def _case(
    polynomials: tuple[int, int], num_steps: int, share_known: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draw input bits, noisy LLRs of them, and the parity at some steps."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, num_steps, dtype=np.uint8)
    llr_a = (1 - 2.0 * bits) * rng.normal(1.5, 2.0, num_steps)
    parity = rsc_encode(bits, *polynomials).astype(np.int8)
    parity[rng.random(num_steps) > share_known] = -1
    return llr_a, parity


@pytest.mark.parametrize("polynomials", POLYNOMIALS)
@pytest.mark.parametrize("share_known", [0.0, 0.1, 0.5, 1.0])
def test_agrees_with_the_equations(polynomials: tuple[int, int], share_known: float) -> None:
    """Extrinsic LLRs are those of the BCJR equations, up to clipping and float32."""
    llr_a, parity = _case(polynomials, 150, share_known, 7)
    table = trellis(*polynomials)
    expected = bcjr(llr_a, parity, table.next_state, table.output)
    found = siso(llr_a, parity, *polynomials)
    near = np.abs(expected) < 15  # metrics are floored at 1e-14 of the likeliest state
    np.testing.assert_allclose(found[near], expected[near], rtol=2e-3, atol=2e-3)
    assert (np.sign(found[~near]) == np.sign(expected[~near])).all()
    assert (np.abs(found[~near]) > 14).all()


@pytest.mark.parametrize("polynomials", POLYNOMIALS)
def test_windows_lose_little(polynomials: tuple[int, int]) -> None:
    """Windows with unknown border states change LLRs near their borders only."""
    llr_a, parity = _case(polynomials, 1200, 0.5, 3)
    whole = siso(llr_a, parity, *polynomials)
    cut = siso(llr_a, parity, *polynomials, num_windows=6)
    inner = np.arange(1200) % 200
    inside = (inner > 60) & (inner < 140)
    np.testing.assert_allclose(cut[inside], whole[inside], atol=0.2)


def test_windows_that_exchange_metrics_converge_to_the_whole() -> None:
    """After as many passes as windows, handing metrics on gives the result of one long window."""
    llr_a, parity = _case((0b111, 0b101), 900, 0.3, 5)
    lanes = lane_layout((0, 900), 8)
    decoder = LaneDecoder(0b111, 0b101, lanes)
    known = np.flatnonzero(parity >= 0).astype(np.int32)
    decoder.set_parity(known, parity[known].astype(np.uint8))
    decoder.llr_a[lanes.cell_of_step] = llr_a
    for _ in range(9):
        _kernels.bit_probabilities(decoder.llr_a, decoder.prob0, decoder.prob1)
        decoder.run()
    whole = siso(llr_a, parity, 0b111, 0b101)
    np.testing.assert_allclose(decoder.llr_e[lanes.cell_of_step], whole, rtol=1e-3, atol=1e-3)


@pytest.mark.nojit
@pytest.mark.parametrize("polynomials", [(0b111, 0b101), (0b11001, 0b11011)])
def test_compiled_and_interpreted_kernels_agree_to_the_bit(
    polynomials: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Machine code and Python give the same float32 metrics, so results do not depend on the machine."""
    llr_a, parity = _case(polynomials, 70, 0.4, 9)
    lanes = lane_layout((0, 30, 70), 2)
    results = []
    for recursions in (bcjr_recursions(*polynomials), tuple(map(python_twin, bcjr_recursions(*polynomials)))):
        decoder = LaneDecoder(*polynomials, lanes)
        known = np.flatnonzero(parity >= 0).astype(np.int32)
        decoder.set_parity(known, parity[known].astype(np.uint8))
        decoder.llr_a[lanes.cell_of_step] = llr_a
        _kernels.bit_probabilities(decoder.llr_a, decoder.prob0, decoder.prob1)
        decoder._forward, decoder._backward = recursions
        decoder.run()
        results.append((decoder.llr_e, decoder.edges))
        for name in ("_gammas", "_add_by_label"):  # the second time as Python, too
            monkeypatch.setattr(_kernels, name, python_twin(getattr(_kernels, name)))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_exponential_and_logarithm_invert_each_other() -> None:
    """LLRs turned into probabilities and back are unchanged within 1e-4, over the whole range."""
    llr = np.linspace(-24, 24, 4801, dtype=np.float32)
    prob0, prob1 = np.empty_like(llr), np.empty_like(llr)
    _kernels.bit_probabilities(llr, prob0, prob1)
    np.testing.assert_allclose(prob0 + prob1, 1, atol=1e-6)
    np.testing.assert_allclose(prob1, 1 / (1 + np.exp(llr.astype(float))), rtol=1e-5)
    back = prob0 / prob1
    _kernels.log_clipped(back, np.float32(30))
    np.testing.assert_allclose(back, llr, atol=1e-4)


@pytest.mark.nojit
def test_contradictions_stay_finite() -> None:
    """Parity that excludes what the priors are sure of gives large numbers, not NaN."""
    llr_a = np.full(200, 24.0)
    parity = np.ones(200, np.int8)
    assert np.isfinite(siso(llr_a, parity, 0b11001, 0b11011)).all()


def test_component_decoder_refuses_bad_arguments() -> None:
    """Shapes, values and numbers of windows are checked."""
    good = np.zeros(9), np.zeros(9, np.int8), 0b111, 0b101
    with pytest.raises(ValueError, match="`llr_a`"):
        siso(np.full(9, np.nan), *good[1:])
    with pytest.raises(ValueError, match="`parity`"):
        siso(good[0], np.full(9, 3, np.int8), 0b111, 0b101)
    with pytest.raises(ValueError, match="do not fit"):
        siso(*good, num_windows=99)
