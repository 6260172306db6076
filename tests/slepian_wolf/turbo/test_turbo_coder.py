"""Turbo codes: iterative decoding by windows, how many check bits are asked for, and when to stop."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.contracts.test_plane_coders import noisy
from dvc.slepian_wolf.checks import CRC_BITS, crc
from dvc.slepian_wolf.coupling import bounded_llr
from dvc.slepian_wolf.turbo import _kernels, turbo_coder
from dvc.slepian_wolf.turbo.turbo_coder import (
    ERROR_EXPONENT,
    LaneDecoder,
    LaneLayout,
    TurboCoder,
    TurboDecoder,
    _Plane,
    bcjr_recursions,
    lane_layout,
)
from dvc.slepian_wolf.turbo.turbo_encoder import trellis
from tests.coders import SEED, encode_planes
from tests.reference.slepian_wolf import bcjr, rsc_encode

BITS = np.random.default_rng(1).integers(0, 2, 64, dtype=np.uint8)


def accepted(plane: _Plane, check: np.ndarray, expected_errors: float) -> tuple[bool, Sequence[int]]:
    """Answer what is asked for from a check; return the verdict, and how many bits each request was for."""
    asking, counts, answer = plane.accept(BITS, expected_errors), list[int](), None
    try:
        while True:
            request = asking.send(answer) if answer is not None else next(asking)
            counts.append(request.count)
            answer = check[request.start : request.start + request.count]
    except StopIteration as end:
        return end.value, counts


def plane_of(num_check_bits: int, size_of_llr: float = 8.0) -> _Plane:
    """Return a plane of which the decisions are likely, with the first bits of its check."""
    plane = _Plane((0, 0), np.where(BITS, -size_of_llr, size_of_llr).astype(np.float32))
    plane.check = crc(BITS, CRC_BITS)[:num_check_bits]
    plane.parity = np.zeros(64, np.uint8)
    return plane


def test_sure_planes_need_no_more_bits() -> None:
    assert accepted(plane_of(CRC_BITS), crc(BITS, CRC_BITS), 2.0**-9) == (True, [])


@pytest.mark.parametrize("exponent", [0, 3])
def test_open_planes_ask_for_what_is_missing(exponent: int) -> None:
    missing = int(ERROR_EXPONENT) - exponent - 6
    check = crc(BITS, CRC_BITS)
    assert accepted(plane_of(6), check, 2.0**-exponent) == (True, [missing])
    assert accepted(plane_of(6), 1 - check, 2.0**-exponent) == (False, [missing])


def test_hopeless_planes_are_given_up() -> None:
    assert accepted(plane_of(6), crc(BITS, CRC_BITS), 2.0 ** (CRC_BITS - ERROR_EXPONENT + 1)) == (False, [])
    plane = plane_of(6)
    plane.check = 1 - plane.check
    assert accepted(plane, crc(BITS, CRC_BITS), 1.0) == (False, [])


def test_decoders_are_made_if_none_is_idle_and_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two planes at once need two decoders; later ones, or those after a failure, get one of these."""
    made: list[TurboDecoder] = []

    class Counted(TurboDecoder):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(self)

    monkeypatch.setattr(turbo_coder, "TurboDecoder", Counted)
    coder = TurboCoder(SEED)
    for _ in range(2):
        planes = [coder.decoder(64).decode(np.full(64, 3.0), (0, number)) for number in range(2)]
        for plane in planes:
            next(plane)
        with pytest.raises(KeyError):
            planes[0].throw(KeyError)
        planes[1].close()
    assert len(made) == 2


@pytest.mark.parametrize(("crossover", "share"), [(0.007, 0.15), (0.031, 0.32), (0.11, 0.8)])
def test_corrects_its_channel(crossover: float, share: float) -> None:
    bits, llr_ch = noisy(np.random.default_rng(4), 1584, crossover)
    decoder = TurboDecoder(1584, SEED)
    decoder.start(bounded_llr(llr_ch))
    decoder.add_parity(encode_planes(bits[None], SEED)[0, : round(share * 1584)])
    assert not decoder.parity_satisfied
    assert decoder.iterate(60) < 60
    assert decoder.parity_satisfied
    np.testing.assert_array_equal(decoder.decisions, bits)
    assert decoder.iterate(5, polish=True) == 5
    assert decoder.expected_errors < 1


def test_goes_on_when_parity_arrives() -> None:
    """Parity that comes in pieces ends in the same decisions, and a restart repeats every number."""
    bits, llr_ch = noisy(np.random.default_rng(5), 1584, 0.07)
    parity = encode_planes(bits[None], SEED)[0]
    decoder = TurboDecoder(1584, SEED)
    runs = []
    for _ in range(2):
        decoder.start(bounded_llr(llr_ch))
        trace = []
        for first in range(0, 900, 100):
            decoder.add_parity(parity[first : first + 100])
            trace.append(decoder.iterate(5))
        runs.append((trace, decoder.decisions.copy()))
        assert decoder.num_parity == 900
        np.testing.assert_array_equal(decoder.decisions, bits)
    assert runs[0][0] == runs[1][0]
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


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


def lane_decoder(
    llr_a: np.ndarray, parity: np.ndarray, polynomials: tuple[int, int], lanes: LaneLayout
) -> LaneDecoder:
    """Return a decoder of one trellis with a-priori LLRs, and the parity that is not -1."""
    decoder = LaneDecoder(*polynomials, lanes)
    steps = np.flatnonzero(parity >= 0).astype(np.int32)
    decoder.set_parity(steps, parity[steps].astype(np.uint8))
    decoder.llr_a[lanes.cell_of_step] = np.clip(llr_a, -_kernels.MAX_EXTRINSIC, _kernels.MAX_EXTRINSIC)
    _kernels.bit_probabilities(decoder.llr_a, decoder.prob0, decoder.prob1)
    return decoder


def siso(llr_a: np.ndarray, parity: np.ndarray, polynomials: tuple[int, int], windows: int = 1) -> np.ndarray:
    """Return the extrinsic LLRs of the input bits of one trellis that starts in state zero."""
    decoder = lane_decoder(llr_a, parity, polynomials, lane_layout((0, llr_a.size), windows))
    decoder.run()
    return decoder.llr_e[decoder.lanes.cell_of_step]


@pytest.mark.parametrize("polynomials", POLYNOMIALS)
@pytest.mark.parametrize("share_known", [0.0, 0.1, 0.5, 1.0])
def test_agrees_with_the_equations(polynomials: tuple[int, int], share_known: float) -> None:
    """Extrinsic LLRs are those of the BCJR equations, up to clipping and float32."""
    llr_a, parity = _case(polynomials, 150, share_known, 7)
    table = trellis(*polynomials)
    expected = bcjr(llr_a, parity, table.next_state, table.output)
    found = siso(llr_a, parity, polynomials)
    near = np.abs(expected) < 15  # metrics are floored at 1e-14 of the likeliest state
    np.testing.assert_allclose(found[near], expected[near], rtol=2e-3, atol=2e-3)
    assert (np.sign(found[~near]) == np.sign(expected[~near])).all()
    assert (np.abs(found[~near]) > 14).all()


@pytest.mark.parametrize("polynomials", POLYNOMIALS)
def test_windows_lose_little(polynomials: tuple[int, int]) -> None:
    llr_a, parity = _case(polynomials, 1200, 0.5, 3)
    whole, cut = (siso(llr_a, parity, polynomials, windows) for windows in (1, 6))
    inner = np.arange(1200) % 200
    inside = (inner > 60) & (inner < 140)
    np.testing.assert_allclose(cut[inside], whole[inside], atol=0.2)


def test_windows_that_exchange_metrics_converge_to_the_whole() -> None:
    """After as many passes as windows, handing metrics on gives the result of one long window."""
    llr_a, parity = _case((0b111, 0b101), 900, 0.3, 5)
    lanes = lane_layout((0, 900), 8)
    decoder = lane_decoder(llr_a, parity, (0b111, 0b101), lanes)
    for _ in range(9):
        decoder.run()
    whole = siso(llr_a, parity, (0b111, 0b101))
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
        decoder = lane_decoder(llr_a, parity, polynomials, lanes)
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
    llr_a = np.full(200, 24.0)
    parity = np.ones(200, np.int8)
    assert np.isfinite(siso(llr_a, parity, (0b11001, 0b11011))).all()
