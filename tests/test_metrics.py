"""Tests of quality measures and Bjontegaard differences."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import RdCurveError
from dvc.metrics import BdResult, bd_psnr, bd_rate, mean_psnr_db, psnr_db, psnr_yuv_db, ssim

RATES = [100.0, 210.0, 380.0, 700.0, 1300.0]
PSNRS_DB = [28.1, 31.0, 33.6, 36.1, 39.0]


def random_curve(rng: np.random.Generator, num_points: int) -> tuple[list[float], list[float]]:
    """Return a random curve over about the same ranges."""
    rates = np.geomspace(100, 1500, num_points) * rng.uniform(0.9, 1.1, num_points)
    psnrs = np.linspace(28, 40, num_points) + rng.uniform(-0.8, 0.8, num_points)
    return rates.tolist(), psnrs.tolist()


def test_psnr_matches_its_definition() -> None:
    """PSNR is computed from the mean squared error and peak 255."""
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 256, (2, 37, 53), dtype=np.uint8)
    error = np.mean((a.astype(float) - b) ** 2)
    assert psnr_db(a, b) == pytest.approx(10 * np.log10(255**2 / error), abs=1e-12)
    assert psnr_db(a, b) == psnr_db(b, a)


def test_psnr_of_extremes() -> None:
    """Equal planes give infinity, opposite ones 0 dB; shapes and types must agree."""
    black, white = np.zeros((5, 4), np.uint8), np.full((5, 4), 255, np.uint8)
    assert (psnr_db(black, black), psnr_db(black, white)) == (math.inf, 0)
    with pytest.raises(ValueError, match="one size"):
        psnr_db(black, black[:4])
    with pytest.raises(ValueError, match="uint8"):
        psnr_db(black, black.astype(float))


def test_mean_psnr_is_the_mean_of_frames() -> None:
    assert mean_psnr_db([30.0, 40.0]) == 35.0
    assert mean_psnr_db([30.0, math.inf]) == math.inf
    with pytest.raises(ValueError, match="empty"):
        mean_psnr_db([])


def test_luma_weighs_most_in_colour() -> None:
    assert psnr_yuv_db(32.0, 40.0, 48.0) == 35.0


def test_ssim_orders_distortions() -> None:
    """SSIM is 1 for equal planes and falls with noise."""
    rng = np.random.default_rng(2)
    plane = (128 + 60 * np.sin(np.arange(64) / 5) * np.ones((48, 1))).astype(np.uint8)
    noisy = [(plane + rng.normal(0, sigma, plane.shape)).clip(0, 255).astype(np.uint8) for sigma in (3, 12)]
    assert ssim(plane, plane) == 1
    assert 1 > ssim(plane, noisy[0]) > ssim(plane, noisy[1]) > 0
    with pytest.raises(ValueError, match="at least 11"):
        ssim(plane[:10], plane[:10])


@pytest.mark.parametrize("seed", range(6))
def test_bd_agrees_with_another_implementation(seed: int) -> None:
    bjontegaard = pytest.importorskip("bjontegaard")
    rng = np.random.default_rng(seed)
    rate_a, psnr_a = random_curve(rng, 5)
    rate_b, psnr_b = random_curve(rng, 7)
    options = {"require_matching_points": False, "min_overlap": 0}
    expected_rate = bjontegaard.bd_rate(rate_a, psnr_a, rate_b, psnr_b, "pchip", **options)
    expected_psnr = bjontegaard.bd_psnr(rate_a, psnr_a, rate_b, psnr_b, "pchip", **options)
    got_rate = bd_rate(rate_a, psnr_a, rate_b, psnr_b)
    got_psnr = bd_psnr(rate_a, psnr_a, rate_b, psnr_b)
    assert got_rate.value == pytest.approx(expected_rate, abs=1e-6)
    assert got_psnr.value == pytest.approx(expected_psnr, abs=1e-6)


@given(factor=st.floats(0.2, 5))
def test_scaled_rates_give_their_factor(factor: float) -> None:
    result = bd_rate(RATES, PSNRS_DB, [factor * rate for rate in RATES], PSNRS_DB)
    assert result.value == pytest.approx(100 * (factor - 1), abs=1e-6)


def test_rates_times_1_1_give_10_per_cent() -> None:
    """The result has its overlap and its numbers of points."""
    result = bd_rate(RATES, PSNRS_DB, [1.1 * rate for rate in RATES], PSNRS_DB)
    expected = BdResult(result.value, (28.1, 39.0), 1.0, (5, 5), (0, 0))
    assert result == expected
    assert result.value == pytest.approx(10, abs=1e-9)


def test_shifted_psnr_gives_its_shift() -> None:
    """A curve half a decibel higher is better by half a decibel, over the rates in common."""
    result = bd_psnr(RATES, PSNRS_DB, RATES, [psnr + 0.5 for psnr in PSNRS_DB])
    assert result.value == pytest.approx(0.5, abs=1e-9)
    assert result.overlap == pytest.approx((100, 1300))


@given(seed=st.integers(0, 10**6))
def test_swapping_curves_inverts_the_ratio(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_curve(rng, 4), random_curve(rng, 6)
    forward, backward = bd_rate(*a, *b).value, bd_rate(*b, *a).value
    assert (1 + forward / 100) * (1 + backward / 100) == pytest.approx(1, abs=1e-9)


def test_order_of_points_does_not_matter() -> None:
    order = [3, 0, 4, 2, 1]
    shuffled = bd_rate([RATES[i] for i in order], [PSNRS_DB[i] for i in order], [50.0, 2000.0], [29.0, 38.0])
    assert shuffled == bd_rate(RATES, PSNRS_DB, [50.0, 2000.0], [29.0, 38.0])


def test_dominated_points_are_left_out_and_counted() -> None:
    plain = bd_rate(RATES, PSNRS_DB, RATES, PSNRS_DB)
    bent = bd_rate([*RATES, 400.0, 380.0], [*PSNRS_DB, 33.6, 20.0], RATES, PSNRS_DB)
    assert bent.value == plain.value == pytest.approx(0, abs=1e-12)
    assert bent.num_dropped == (2, 0)
    assert bent.num_points == (5, 5)


def test_rates_that_differ_by_rounding_are_one() -> None:
    twice = bd_rate([100.00000000000001, 100.0, 200.0], [30.0, 29.0, 33.0], [100.0, 200.0], [30.0, 33.0])
    assert (twice.value, twice.num_points, twice.num_dropped) == (0.0, (2, 2), (1, 0))
    swapped = bd_psnr([100.0, 100.00000000000001, 200.0], [29.0, 30.0, 33.0], [100.0, 200.0], [30.0, 33.0])
    assert swapped.value == 0.0


def test_disjoint_curves_are_refused() -> None:
    higher = [psnr + 10.9 for psnr in PSNRS_DB]
    with pytest.raises(RdCurveError, match="no PSNR in common"):
        bd_rate(RATES, PSNRS_DB, RATES, higher)
    with pytest.raises(RdCurveError, match="no rate in common"):
        bd_psnr(RATES, PSNRS_DB, [20 * rate for rate in RATES], PSNRS_DB)


@pytest.mark.parametrize(
    ("rates", "psnrs", "message"),
    [
        ([100.0], [30.0], "1 useful points of 1"),
        ([100.0, 200.0], [30.0, 30.0], "1 useful points of 2"),
        ([100.0, 0.0], [30.0, 31.0], "positive"),
        ([100.0, 200.0], [30.0, math.inf], "finite"),
        ([100.0, 200.0], [30.0], "2 rates for 1 PSNRs"),
    ],
)
def test_unusable_curves_are_refused(rates: list[float], psnrs: list[float], message: str) -> None:
    with pytest.raises(RdCurveError, match=message):
        bd_rate(RATES, PSNRS_DB, rates, psnrs)
