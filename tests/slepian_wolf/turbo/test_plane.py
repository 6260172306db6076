"""Tests of the decoding of one plane, from its first request to its result."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from dvc.slepian_wolf import ParityRequest, SlepianWolfSettings, TurboDecoder, decode_plane, family
from tests.reference.turbo_exchange import decoder_of, exchange, noisy

DEFAULT = SlepianWolfSettings()
CLASSICAL = SlepianWolfSettings(family="classical")


@given(
    st.integers(1, 200), st.integers(0, 10**6), st.floats(0.0, 12.0), st.sampled_from([DEFAULT, CLASSICAL])
)
@hypothesis_settings(max_examples=60)
def test_garbage_priors_end_exactly(
    num_bits: int, seed: int, spread: float, settings: SlepianWolfSettings
) -> None:
    """LLRs that have nothing to do with the bits cost at most one bit per bit, and the plane is exact."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    result = exchange(bits, rng.normal(0, spread, num_bits), settings)
    assert result.parity_bits <= num_bits
    assert result.crc_bits <= settings.crc_bits
    assert result.success
    np.testing.assert_array_equal(result.bits, bits)


@pytest.mark.parametrize("settings", [DEFAULT, CLASSICAL], ids=["adaptive", "classical"])
def test_every_short_length_comes_back(settings: SlepianWolfSettings) -> None:
    """Planes of every length up to 60 with fair side information are exact."""
    rng = np.random.default_rng(12)
    for num_bits in range(1, 61):
        bits, llr_ch = noisy(rng, num_bits, 0.1)
        result = exchange(bits, llr_ch, settings)
        assert result.success
        np.testing.assert_array_equal(result.bits, bits)


@pytest.mark.parametrize("size", [1584, 2000])
def test_garbage_of_picture_size(size: int) -> None:
    """Sure and wrong side information of a whole band still ends with an exact plane."""
    rng = np.random.default_rng(size)
    bits = rng.integers(0, 2, size, dtype=np.uint8)
    result = exchange(bits, rng.choice([-20.0, 20.0, 0.5], size), DEFAULT)
    assert result.success
    assert result.parity_bits <= size
    np.testing.assert_array_equal(result.bits, bits)


@pytest.mark.parametrize("bit", [0, 1])
def test_right_and_sure_planes_cost_their_check_only(bit: int) -> None:
    """A plane that the prior is right and sure about needs eight bits or a few more."""
    bits = np.full(1584, bit, np.uint8)
    result = exchange(bits, np.full(1584, 20.0) * (1 - 2 * bit), DEFAULT)
    assert (result.success, result.parity_bits, result.iterations) == (True, 0, 0)
    assert 8 <= result.crc_bits <= 16


def test_sure_prior_with_one_outlier() -> None:
    """One bit that is wrong against an LLR of 20 costs some parity, not the plane."""
    bits = np.zeros(1584, np.uint8)
    bits[700] = 1
    result = exchange(bits, np.full(1584, 20.0), DEFAULT)
    assert result.success
    assert 0 < result.parity_bits < 100
    np.testing.assert_array_equal(result.bits, bits)


def test_hopeless_planes_are_sent_plainly() -> None:
    """Where the prior says nothing the plane is requested as it is, without any check."""
    bits = np.random.default_rng(1).integers(0, 2, 400, dtype=np.uint8)
    result = exchange(bits, np.zeros(400), DEFAULT)
    assert (result.success, result.parity_bits, result.crc_bits, result.num_requests) == (True, 400, 0, 1)


@pytest.mark.parametrize(
    ("num_bits", "probability", "most"),
    [(6336, 0.01, 1.45), (6336, 0.03, 1.25), (6336, 0.07, 1.18), (6336, 0.12, 1.16), (6336, 0.2, 1.15)],
)
def test_rate_is_near_the_entropy(num_bits: int, probability: float, most: float) -> None:
    """On average over three planes, parity stays within the bracket of the published designs."""
    entropy = -probability * np.log2(probability) - (1 - probability) * np.log2(1 - probability)
    rng = np.random.default_rng(23)
    parity = 0
    for _ in range(3):
        bits, llr_ch = noisy(rng, num_bits, probability)
        result = exchange(bits, llr_ch, DEFAULT)
        assert result.success
        np.testing.assert_array_equal(result.bits, bits)
        parity += result.parity_bits
    assert 0.9 < parity / (3 * num_bits * entropy) < most


def test_mixture_of_sure_and_unsure_bits() -> None:
    """Bits of unequal quality cost little more than the mean of their entropies."""
    rng = np.random.default_rng(3)
    probability = np.where(rng.random(6336) < 0.7, 0.001, 0.2)
    entropy = -probability * np.log2(probability) - (1 - probability) * np.log2(1 - probability)
    bits, llr_ch = noisy(rng, 6336, probability)
    result = exchange(bits, llr_ch, DEFAULT)
    np.testing.assert_array_equal(result.bits, bits)
    assert result.parity_bits < 1.25 * entropy.sum()


def test_repeats_itself() -> None:
    """The same plane and side information give the same requests, with a fresh decoder as with a used one."""
    bits, llr_ch = noisy(np.random.default_rng(8), 1584, 0.05)
    first = exchange(bits, llr_ch, DEFAULT)
    decoder_of.cache_clear()
    second = exchange(bits, llr_ch, DEFAULT)
    assert replace(first, bits=bits) == replace(second, bits=bits)


def test_first_request_is_for_check_bits() -> None:
    """The coroutine asks for the first check bits, then for a conservative amount of parity."""
    _, llr_ch = noisy(np.random.default_rng(2), 1584, 0.07)
    coroutine = decode_plane(llr_ch, lambda index: TurboDecoder(family()[index], 1584, 1), DEFAULT, (3, 5))
    assert next(coroutine) == ParityRequest(3, 5, "crc", 7, 0, 8)
    request = coroutine.send(np.ones(8, np.uint8))
    assert (request.kind, request.code, request.start) == ("parity", 7, 0)
    assert 0.7 < request.count / (1584 * 0.366) < 0.8


@pytest.mark.parametrize("answer", [np.zeros(7, np.uint8), np.zeros(8), np.full(8, 2, np.uint8)])
def test_refuses_wrong_answers(answer: np.ndarray) -> None:
    """Bits of the wrong number, type or value end the coroutine."""
    _, llr_ch = noisy(np.random.default_rng(2), 1584, 0.07)
    coroutine = decode_plane(llr_ch, lambda index: TurboDecoder(family()[index], 1584, 1), DEFAULT)
    next(coroutine)
    with pytest.raises(ValueError, match="expected 8 crc bits"):
        coroutine.send(answer)


@pytest.mark.parametrize("llr_ch", [np.zeros(0), np.zeros((2, 2)), np.array([1.0, np.nan])])
def test_refuses_bad_side_information(llr_ch: np.ndarray) -> None:
    """Side information must be a vector of numbers."""
    with pytest.raises(ValueError, match="`llr_ch`"):
        next(decode_plane(llr_ch, lambda index: TurboDecoder(family()[index], 4, 1), DEFAULT))


@pytest.mark.parametrize(
    "changes",
    [
        {"crc_bits": 9},
        {"first_crc_bits": 0},
        {"max_prior_llr": 0.0},
        {"step": 0.0},
        {"late_step": 1.5},
        {"stuck_step": 0.0},
        {"iterations": 0},
        {"stuck_iterations": 99},
    ],
)
def test_refuses_bad_settings(changes: dict[str, object]) -> None:
    """Settings out of range are refused."""
    with pytest.raises(ValueError, match="`"):
        replace(DEFAULT, **changes)  # type: ignore[arg-type]


def test_stuck_planes_take_larger_steps_and_fewer_iterations() -> None:
    """Where the prior is surer than it may be, larger steps while stuck save requests and iterations."""
    rng = np.random.default_rng(17)
    bits, llr_ch = noisy(rng, 1200, 0.08)
    patient = exchange(bits, 1.6 * llr_ch, SlepianWolfSettings(step=0.01, search_work=0.0))
    settings = SlepianWolfSettings(
        step=0.01, search_work=0.0, min_step_bits=3, stuck_step=0.04, stuck_iterations=2
    )
    hasty = exchange(bits, 1.6 * llr_ch, settings)
    np.testing.assert_array_equal(hasty.bits, bits)
    assert hasty.num_requests < 0.8 * patient.num_requests
    assert hasty.iterations < 0.8 * patient.iterations
    assert hasty.parity_bits < 1.1 * patient.parity_bits
