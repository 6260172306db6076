"""The correlation noise model against SciPy's Laplacian, and its scales against known noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv import noise
from tests.reference import wynerziv_noise as reference

Array = np.ndarray


@given(
    st.floats(-300, 300), st.floats(0, 200), st.floats(-300, 300), st.floats(noise.MIN_SCALE, 100)
)  # fmt: skip
def test_interval_probability(lower: float, width: float, side_information: float, scale: float) -> None:
    """Probabilities of intervals are those of the distribution, to full relative precision in the tails."""
    arguments = [np.array([value]) for value in (lower, lower + width, side_information, scale)]
    expected = reference.interval_probability(lower, lower + width, side_information, scale)
    got = noise.interval_probability(*arguments)[0]
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-300 if width > 1e-3 else 1e-16)


def test_probabilities_of_all_bins_add_up_to_one() -> None:
    """A partition of the line has probability one."""
    edges = np.concatenate([[-1e6], np.linspace(-50.0, 50.0, 41), [1e6]])
    probability = noise.interval_probability(edges[:-1], edges[1:], np.full(42, 3.3), np.full(42, 5.0))
    assert probability.sum() == pytest.approx(1.0, abs=1e-12)


def test_bit_llr_is_the_ratio_of_both_halves() -> None:
    """Positive means bit 0: the coefficient is more likely below the middle."""
    lower, middle, upper = (np.array([value]) for value in (-8.0, 0.0, 8.0))
    scale = np.array([3.0])
    for predicted in (-7.0, -2.0, 0.0, 2.0, 7.0):
        zero = reference.interval_probability(-8.0, 0.0, predicted, 3.0)
        one = reference.interval_probability(0.0, 8.0, predicted, 3.0)
        got = noise.bit_llr(lower, middle, upper, np.array([predicted]), scale)[0]
        assert got == pytest.approx(np.log(zero / one), abs=0.02)
    assert noise.bit_llr(lower, middle, upper, np.array([-5.0]), scale)[0] > 0


def test_bit_llr_is_finite_and_bounded_by_outliers() -> None:
    """Side information far away never gives certainty, and empty intervals no warning."""
    lower, middle, upper = (np.array(v) for v in ([0.0, 5.0, 5.0], [4.0, 5.0, 7.0], [8.0, 5.0, 7.0]))
    for predicted in (-1e4, 0.0, 1e4):
        llr = noise.bit_llr(lower, middle, upper, np.full(3, predicted), np.full(3, noise.MIN_SCALE))
        assert np.isfinite(llr).all()
        assert np.abs(llr[0]) < 12


@pytest.mark.parametrize("truth", [0.5, 1.0, 2.0])
def test_fit_gain_recovers_the_scale(truth: float) -> None:
    """Intervals of Laplacian samples give back the factor between assumed and true scale."""
    rng = np.random.default_rng(7)
    predicted = rng.uniform(-100.0, 100.0, 4000)
    coefficient = predicted + rng.laplace(0.0, 6.0 * truth, 4000)
    lower = 4.0 * np.floor(coefficient / 4.0)
    gain = noise.fit_gain(lower, lower + 4.0, predicted, np.full(4000, 6.0), expected=1.0)
    assert gain == pytest.approx(truth, rel=0.1)


def test_fit_gain_keeps_its_expectation_without_evidence() -> None:
    """Where nothing has been decoded the expected factor is the best one."""
    nothing = np.empty(0)
    assert noise.fit_gain(nothing, nothing, nothing, nothing, expected=2.0) == pytest.approx(2.0)


@pytest.mark.parametrize("name", noise.MODELS)
def test_scales_follow_the_residual(name: str) -> None:
    """On a Laplacian residual each model finds about its scale, and never less on a larger residual."""
    residual = np.random.default_rng(3).laplace(0.0, 5.0, (16, 30, 40))
    scale = noise.MODELS[name](residual)
    assert scale.shape == residual.shape
    assert scale.mean() == pytest.approx(5.0, rel=0.35)
    assert (noise.MODELS[name](2.0 * residual) >= scale).all()


@pytest.mark.parametrize("name", noise.MODELS)
def test_identical_references_give_the_smallest_scale(name: str) -> None:
    """No residual leaves the floor that rounding makes."""
    np.testing.assert_allclose(noise.MODELS[name](np.zeros((16, 2, 3))), noise.MIN_SCALE)


def test_band_scale_is_constant_in_each_band() -> None:
    """The band model tells bands apart, the frame model does not."""
    residual = np.random.default_rng(4).normal(0.0, 1.0, (16, 8, 8)) * np.arange(1, 17)[:, None, None]
    band = noise.band_scale(residual)
    np.testing.assert_array_equal(band, band[:, :1, :1] * np.ones((1, 8, 8)))
    assert band[15, 0, 0] > 5 * band[0, 0, 0]
    assert np.unique(noise.frame_scale(residual)).size == 1


def test_coefficient_scale_raises_unusual_blocks() -> None:
    """A block with an outstanding residual gets a scale above its band's, all others the band's."""
    residual = np.random.default_rng(5).normal(0.0, 1.0, (1, 10, 10)).clip(-1, 1)
    residual[0, 4, 4] = 40.0
    scale = noise.coefficient_scale(residual)
    assert scale[0, 4, 4] == pytest.approx((40.0 - np.abs(residual).mean()) / np.sqrt(2.0))
    assert np.unique(np.delete(scale.ravel(), 44)).size == 1
