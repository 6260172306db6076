"""Planes and frames decoded by parities of ranges: exact, cheap, and whatever the side information says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.slepian_wolf import PlaneResult, SlepianWolfSettings, drive, joint_check, plane_decoder
from dvc.slepian_wolf.cascade.frame import CascadeDecoder
from dvc.slepian_wolf.cascade.posterior import RangePosterior
from dvc.slepian_wolf.cascade.reconciliation import CascadeSettings, PlaneReconciliation
from dvc.slepian_wolf.requests import ask
from tests.reference.cascade_exchange import SEED, Bits, PlaneSource
from tests.reference.turbo_exchange import noisy

SETTINGS = CascadeSettings()


def exchange(bits: Bits, llr_ch: np.ndarray, settings: CascadeSettings = SETTINGS) -> PlaneResult:
    """Decode one plane by itself, and check that it pays for every bit once."""
    source = PlaneSource(bits[None])
    plane = PlaneReconciliation(llr_ch, settings)
    result = drive(plane.decode(RangePosterior(bits.size, SEED)), source.answer)
    assert result.parity_bits == source.paid["parity"] + source.paid["uncoded"]
    assert result.crc_bits == source.paid["crc"] <= SETTINGS.crc_bits
    return result


BATCHED = CascadeSettings(batch=0.8)
AMPLE = CascadeSettings(batch=0.5, batch_bits=4)


@given(
    st.integers(1, 120),
    st.integers(0, 10**6),
    st.floats(0.0, 12.0),
    st.sampled_from([SETTINGS, BATCHED, AMPLE]),
)
@settings(max_examples=60, deadline=None)
def test_garbage_priors_end_exactly(num_bits: int, seed: int, spread: float, how: CascadeSettings) -> None:
    """LLRs that have nothing to do with the bits cost at most two bits per bit; sure ones may deceive."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    llr = np.clip(rng.normal(0, spread, num_bits), -how.max_prior_llr, how.max_prior_llr)
    result = exchange(bits, llr, how)
    assert result.parity_bits <= 2 * num_bits
    odds_against = np.abs(llr)[(llr < 0) != bits].sum() / np.log(2)
    if odds_against < how.error_exponent:
        np.testing.assert_array_equal(result.bits, bits)


def test_every_short_length_comes_back() -> None:
    """Planes of every length up to 60 with fair side information are exact."""
    rng = np.random.default_rng(12)
    for num_bits in range(1, 61):
        bits, llr_ch = noisy(rng, num_bits, 0.1)
        np.testing.assert_array_equal(exchange(bits, llr_ch).bits, bits)


@pytest.mark.parametrize(("probability", "most"), [(0.005, 1.25), (0.03, 1.13), (0.12, 1.1)])
def test_uniform_channels_cost_little_more_than_their_entropy(probability: float, most: float) -> None:
    """Planes with errors of one probability cost, check bits included, little more than the ideal length."""
    rng = np.random.default_rng(4)
    paid = ideal = 0.0
    for _ in range(6):
        bits, llr_ch = noisy(rng, 3000, probability)
        result = exchange(bits, llr_ch)
        np.testing.assert_array_equal(result.bits, bits)
        paid += result.parity_bits + result.crc_bits
        ideal += result.ideal_bits
    assert 0.95 * ideal < paid < most * ideal


def test_unequal_channels_cost_little_more_than_their_entropy() -> None:
    """The same where side information knows some bits better than others."""
    rng = np.random.default_rng(5)
    paid = ideal = 0.0
    for _ in range(5):
        bits, llr_ch = noisy(rng, 3000, rng.beta(0.4, 4.0, 3000).clip(1e-3, 0.499))
        result = exchange(bits, llr_ch)
        np.testing.assert_array_equal(result.bits, bits)
        paid += result.parity_bits + result.crc_bits
        ideal += result.ideal_bits
    assert paid < 1.1 * ideal


def test_sure_prior_with_outliers() -> None:
    """A few bits that are wrong against an LLR of 20 cost some parities, not the plane."""
    bits = np.zeros(1584, np.uint8)
    bits[[3, 700, 701, 1500]] = 1
    result = exchange(bits, np.full(1584, 20.0))
    assert result.parity_bits < 200
    np.testing.assert_array_equal(result.bits, bits)


def test_right_and_sure_planes_cost_little() -> None:
    """A plane that the prior is right and sure about costs its check and a parity or two."""
    result = exchange(np.zeros(1584, np.uint8), np.full(1584, 20.0))
    assert result.parity_bits <= 4
    assert result.crc_bits <= 16


def test_hopeless_planes_are_sent_plainly() -> None:
    """Where the prior says nothing the plane is requested as it is."""
    bits = np.random.default_rng(1).integers(0, 2, 400, dtype=np.uint8)
    result = exchange(bits, np.zeros(400))
    assert (result.parity_bits, result.crc_bits, result.num_requests) == (400, 0, 1)


@given(st.integers(2, 80), st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_answers_that_fit_no_plane_end(num_bits: int, seed: int) -> None:
    """Whatever a damaged payload answers, decoding ends after a bounded number of bits."""
    rng = np.random.default_rng(seed)
    decoder = CascadeDecoder(SETTINGS, num_bits, SEED)
    total = 0

    def answer(request: object) -> Bits:
        nonlocal total
        total += request.count  # type: ignore[attr-defined]
        return rng.integers(0, 2, request.count, dtype=np.uint8)  # type: ignore[attr-defined]

    for plane in range(3):
        drive(decoder.decode(rng.normal(1.0, 2.0, num_bits), (0, plane)), answer)
    check = drive(decoder.check(), answer)
    assert total <= 3 * (2 * num_bits + 200)
    assert len(check.corrected) <= 3


def test_wrong_planes_are_found_and_corrected() -> None:
    """A plane that passed by itself, but is wrong, fails the check of the frame, and comes out right."""
    rng = np.random.default_rng(8)
    planes = rng.integers(0, 2, (9, 300), dtype=np.uint8)
    llr = (1 - 2.0 * planes) * 4.0
    source = PlaneSource(planes)
    decoder = CascadeDecoder(SETTINGS, 300, SEED)
    for plane in range(9):
        result = drive(decoder.decode(llr[plane], (0, plane)), source.answer)
        if plane in (2, 7):  # forge what was decoded, as an undetected error would
            wrong = result.bits.copy()
            wrong[[11, 200]] ^= 1
            own = decoder._planes[plane][0]
            forged = PlaneResult(wrong, True, 1, 0, 0, 0, 0.0, 0.0)
            decoder._planes[plane] = own, forged
    check = drive(decoder.check(), source.answer)
    assert check.success
    assert {2, 7} <= set(check.corrected)
    assert check.crc_bits == source.paid["joint"]
    for plane, result in check.corrected.items():
        np.testing.assert_array_equal(result.bits, planes[plane])
    assert drive(decoder.check(), source.answer).crc_bits == 0  # nothing is left to be checked


def test_the_same_error_in_two_planes_shows() -> None:
    """Check bits of several planes together are no plain sum: equal errors do not cancel out."""
    checks = np.random.default_rng(2).integers(0, 2, (5, 16), dtype=np.uint8)
    changed = checks.copy()
    changed[[1, 3], 4] ^= 1
    assert (joint_check(checks) != joint_check(changed)).any()


def test_frames_by_the_family_name() -> None:
    """Through `plane_decoder`, a frame of planes of all entropies comes back for little more than ideal."""
    rng = np.random.default_rng(6)
    num_bits = 1584
    decoder = plane_decoder(SlepianWolfSettings(family="cascade"), num_bits, SEED)
    paid = ideal = 0.0
    for frame in range(2):
        drawn = [noisy(rng, num_bits, p) for p in (0.15, 0.06, 0.02, 0.01, 0.004, 0.002)]
        source = PlaneSource(np.stack([bits for bits, _ in drawn]))
        results = [drive(decoder.decode(llr, (frame, n)), source.answer) for n, (_, llr) in enumerate(drawn)]
        check = drive(decoder.check(frame), source.answer)
        assert check.success
        for n, (bits, _) in enumerate(drawn):
            np.testing.assert_array_equal(check.corrected.get(n, results[n]).bits, bits)
        paid += sum(source.paid.values())
        ideal += sum(result.ideal_bits for result in results)
    assert paid < 1.2 * ideal


def test_answers_of_another_length_are_refused() -> None:
    """A coroutine that is sent what it did not ask for says so."""
    plane = PlaneReconciliation(np.full(50, 2.0), SETTINGS).decode(RangePosterior(50, SEED))
    request = next(plane)
    with pytest.raises(ValueError, match="expected"):
        plane.send(np.zeros(request.count + 1, np.uint8))
    asking = ask(request)
    next(asking)
    with pytest.raises(ValueError, match="expected"):
        asking.send(np.full(request.count, 2, np.uint8))


@pytest.mark.parametrize("llr", [np.zeros((2, 3)), np.array([np.nan]), np.zeros(0)])
def test_side_information_must_be_a_vector_of_numbers(llr: np.ndarray) -> None:
    """Other shapes and NaN are refused."""
    with pytest.raises(ValueError, match="llr_ch"):
        PlaneReconciliation(llr, SETTINGS)


@pytest.mark.parametrize("field", [{"crc_bits": 9}, {"max_prior_llr": 0.0}, {"max_prior_llr": 90.0}])
def test_settings_are_checked(field: dict[str, float]) -> None:
    """Settings that no decoder can go by are refused."""
    with pytest.raises(ValueError, match="must be"):
        CascadeSettings(**field)


@pytest.mark.parametrize(
    ("batched", "fewer"), [(BATCHED, 0.67), (AMPLE, 0.5)], ids=["by-share", "with-new-orders"]
)
@pytest.mark.parametrize(("probability", "most"), [(0.005, 1.5), (0.03, 1.5), (0.12, 1.3)])
def test_batches_take_fewer_requests_for_some_more_bits(
    probability: float, most: float, batched: CascadeSettings, fewer: float
) -> None:
    """Planes are as exact; requests are less than two thirds, or a half with new orders; bits some more."""
    rng = np.random.default_rng(4)
    requests, ideal, paid = [0, 0], 0.0, 0
    for _ in range(6):
        bits, llr_ch = noisy(rng, 3000, probability)
        for number, how in enumerate((SETTINGS, batched)):
            result = exchange(bits, llr_ch, how)
            np.testing.assert_array_equal(result.bits, bits)
            requests[number] += result.num_requests
        paid += result.parity_bits + result.crc_bits
        ideal += result.ideal_bits
    assert requests[1] < fewer * requests[0]
    assert paid < most * ideal


@pytest.mark.parametrize("field", [{"batch": 1.1}, {"batch_bits": -1}, {"batch_bits": float("nan")}])
def test_a_batch_is_a_share_and_a_number_of_bits(field: dict[str, float]) -> None:
    """Shares beyond one, and bits below zero, are refused."""
    with pytest.raises(ValueError, match="batch"):
        CascadeSettings(**field)
