"""The correlation noise model against SciPy's Laplacian, and its scales against known noise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc._jit import python_twin
from dvc.wynerziv import _kernels, noise, quantizer
from dvc.wynerziv.noise import REFINEMENT_OUTLIER_PROBABILITY, expected_refinement
from tests.reference import wynerziv as reference

Array = np.ndarray


def interval_probability(lower: Array, upper: Array, side_information: Array, scale: Array) -> Array:
    probability = np.empty_like(lower)
    _kernels.interval_probability(lower, upper, side_information, scale, probability)
    return probability


@given(
    st.floats(-300, 300), st.floats(0, 200), st.floats(-300, 300), st.floats(noise.MIN_SCALE, 100)
)  # fmt: skip
def test_interval_probability(lower: float, width: float, side_information: float, scale: float) -> None:
    """Probabilities of intervals are those of the distribution, to full relative precision in the tails."""
    arguments = [np.array([value]) for value in (lower, lower + width, side_information, scale)]
    expected = reference.interval_probability(lower, lower + width, side_information, scale)
    got = interval_probability(*arguments)[0]
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-300 if width > 1e-3 else 1e-16)


@given(st.floats(-700, 0))
def test_exponential(x: float) -> None:
    """The exponential is that of the library, but for the last digits, and nothing overflows below."""
    power, q = _kernels.exponential(x)
    assert power * (1 + q) == pytest.approx(math.exp(x), rel=1e-15)
    assert _kernels.exponential(-1e9) == _kernels.exponential(-700.0)


@given(st.floats(1e-300, 1e300))
def test_logarithm(x: float) -> None:
    assert _kernels.logarithm(x) == pytest.approx(math.log(x), rel=1e-14, abs=1e-15)


@pytest.mark.nojit
def test_compiled_and_interpreted_kernels_agree_to_the_bit() -> None:
    """Machine code and Python give the same numbers, so results do not depend on the machine."""
    rng = np.random.default_rng(8)
    predicted = rng.normal(0.0, 30.0, 130)
    lower = 4.0 * np.floor((predicted + rng.laplace(0.0, 6.0, 130)) / 4.0)
    scale = rng.uniform(0.3, 20.0, 130)
    middle, upper = lower + 2.0, lower + 4.0
    results = []
    for choose in (lambda kernel: kernel, python_twin):
        llr, mean, scores = np.empty(130), np.empty(130), np.empty(noise.GAINS.size)
        choose(_kernels.bit_llr)(lower, middle, upper, predicted, scale, 1e-4, llr)
        choose(_kernels.conditional_mean)(lower, upper, predicted, scale, mean)
        choose(_kernels.log_likelihoods)(lower, upper, predicted, scale, noise.GAINS, 3, 1e-4, scores)
        results.append((llr, mean, scores))
    for compiled, interpreted in zip(*results, strict=True):
        np.testing.assert_array_equal(compiled, interpreted)


def test_log_likelihoods() -> None:
    rng = np.random.default_rng(9)
    predicted = rng.normal(0.0, 30.0, 777)
    lower = 4.0 * np.floor((predicted + rng.laplace(0.0, 6.0, 777)) / 4.0)
    scale, scores = rng.uniform(0.3, 20.0, 777), np.empty(noise.GAINS.size)
    _kernels.log_likelihoods(lower, lower + 4.0, predicted, scale, noise.GAINS, 3, 1e-4, scores)
    for gain, score in zip(noise.GAINS, scores, strict=True):
        probability = interval_probability(lower, lower + 4.0, predicted, scale * gain)
        assert score == pytest.approx(np.log(probability * (1 - 1e-4) + 1e-4).sum(), rel=1e-12)


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
    rng = np.random.default_rng(7)
    predicted = rng.uniform(-100.0, 100.0, 4000)
    coefficient = predicted + rng.laplace(0.0, 6.0 * truth, 4000)
    lower = 4.0 * np.floor(coefficient / 4.0)
    gain = noise.fit_gain(lower, lower + 4.0, predicted, np.full(4000, 6.0), expected=1.0)
    assert gain == pytest.approx(truth, rel=0.1)


def test_fit_gain_keeps_its_expectation_without_evidence() -> None:
    nothing = np.empty(0)
    assert noise.fit_gain(nothing, nothing, nothing, nothing, expected=2.0) == pytest.approx(2.0)


@pytest.mark.parametrize("name", noise.MODELS)
def test_scales_follow_the_residual(name: str) -> None:
    """They are about those of a Laplacian residual, the same each time, and at least the floor; finite."""
    model = noise.MODELS[name]
    residual = np.random.default_rng(3).laplace(0.0, 5.0, (16, 30, 40))
    scale = model(residual.copy())
    assert scale.shape == residual.shape
    assert scale.dtype == np.float64
    assert scale.mean() == pytest.approx(5.0, rel=0.35)
    assert (model(2.0 * residual) >= scale).all()
    np.testing.assert_allclose(model(np.zeros((16, 2, 3))), noise.MIN_SCALE)
    for shape in ((16, 1, 1), (16, 1, 7), (16, 5, 1)):
        residual = np.random.default_rng(1).normal(0.0, 9.0, shape)
        before = residual.copy()
        scale = model(residual)
        assert np.isfinite(scale).all()
        assert (scale >= noise.MIN_SCALE).all()
        np.testing.assert_array_equal(residual, before)
        assert model(residual).tobytes() == scale.tobytes()


def test_band_scale_is_constant_in_each_band() -> None:
    residual = np.random.default_rng(4).normal(0.0, 1.0, (16, 8, 8)) * np.arange(1, 17)[:, None, None]
    band = noise.MODELS["band"](residual)
    np.testing.assert_array_equal(band, band[:, :1, :1] * np.ones((1, 8, 8)))
    assert band[15, 0, 0] > 5 * band[0, 0, 0]
    assert np.unique(noise.MODELS["frame"](residual)).size == 1


def test_coefficient_scale_raises_unusual_blocks() -> None:
    """A block with an outstanding residual gets a scale above its band's, all others the band's."""
    residual = np.random.default_rng(5).normal(0.0, 1.0, (1, 10, 10)).clip(-1, 1)
    residual[0, 4, 4] = 40.0
    scale = noise.MODELS["coefficient"](residual)
    assert scale[0, 4, 4] == pytest.approx((40.0 - np.abs(residual).mean()) / np.sqrt(2.0))
    assert np.unique(np.delete(scale.ravel(), 44)).size == 1


def test_local_scale_spreads_to_neighbours() -> None:
    """Beside an unusual block scales are larger by a share of it, elsewhere by that of the band alone."""
    residual = np.zeros((1, 9, 9))
    residual[0, 4, 4] = 81.0
    scale = noise.MODELS["local"](residual)[0] - noise.MIN_SCALE
    assert scale[0, 0] == pytest.approx(0.3)
    assert scale[3, 5] == pytest.approx(0.3 + 0.5 * 9.0)
    assert scale[4, 4] == pytest.approx(0.3 + 0.5 * 9.0 + 0.3 * 81.0)


def test_scales_grow_with_the_fourth_root_of_texture() -> None:
    texture, expected = np.array([[16.0, 81.0]]), np.array([[1.0, 4.0]])
    for error, ratio in ((None, 1.5), (expected, 3.0)):
        first, second = noise.shaped(np.full((1, 2), 5.0), texture, error)[0]
        assert second / first == pytest.approx(ratio)


def test_shape_moves_scale_to_texture_and_expected_error_and_keeps_the_mean() -> None:
    bands = np.zeros((16, 4, 6))
    bands[3, 1, 2] = -90.0
    scale, expected = np.full((4, 6), 5.0), np.ones((4, 6))
    expected[2, 4] = 9.0
    for band in (0, 3, 7):
        shaped = noise.shaped(scale, noise.texture(bands, band), expected)
        assert shaped.mean() == pytest.approx(5.0)
        assert shaped[2, 4] == pytest.approx(3.0 * shaped[0, 0])
        assert shaped[1, 2] > 1.2 * shaped[0, 0]
    own, other = (noise.shaped(scale, noise.texture(bands, band), None) for band in (3, 7))
    assert own[1, 2] > other[1, 2]


def test_shape_leaves_even_scales_alone_and_keeps_the_floor() -> None:
    flat = noise.texture(np.zeros((16, 3, 3)), 2)
    np.testing.assert_allclose(noise.shaped(np.full((3, 3), 2.0), flat, None), 2.0)
    assert np.all(noise.shaped(np.zeros((3, 3)) + 1e-3, flat, None) == noise.MIN_SCALE)


def mean_of(lower: float, upper: float, side_information: float, scale: float) -> float:
    arguments = (np.array([value]) for value in (lower, upper, side_information, scale))
    return float(noise.conditional_mean(*arguments)[0])


@given(st.floats(-200, 200), st.floats(0.01, 300), st.floats(-500, 500), st.floats(0.3, 100))
def test_equals_quadrature(lower: float, width: float, side_information: float, scale: float) -> None:
    """The closed form is the mean of the Laplacian over the bin, wherever the side information lies."""
    expected = reference.conditional_mean(lower, lower + width, side_information, scale)
    tolerance = 1e-6 * width + 1e-7 * scale
    assert mean_of(lower, lower + width, side_information, scale) == pytest.approx(expected, abs=tolerance)


@given(st.floats(-1e4, 1e4), st.floats(0, 1e4), st.floats(-1e4, 1e4), st.floats(1e-3, 1e4))
def test_stays_in_the_bin(lower: float, width: float, side_information: float, scale: float) -> None:
    assert lower <= mean_of(lower, lower + width, side_information, scale) <= lower + width


@pytest.mark.parametrize(
    ("case", "expected", "tolerance"),
    [
        ((-4.0, 4.0, 0.0, 3.0), 0.0, 0.0),  # in the middle, by symmetry
        ((0.0, 100.0, -50.0, 2.0), 2.0, 1e-6),  # from afar one scale inside the closer border
        ((0.0, 100.0, 150.0, 2.0), 98.0, 1e-6),
        ((0.0, 100.0, -1e9, 2.0), 2.0, 1e-6),
        ((0.0, 10.0, 1.0, 1e6), 5.0, 1e-3),  # unreliable: the middle
        ((0.0, 10.0, 3.0, 1e-3), 3.0, 1e-6),  # reliable: itself
        ((12.0, 12.0, 3.0, 1.0), 12.0, 0.0),  # a bin without width
    ],
)
def test_reconstructions(case: tuple[float, float, float, float], expected: float, tolerance: float) -> None:
    assert mean_of(*case) == pytest.approx(expected, rel=0, abs=tolerance)


PLANES, STEP = 7, 10.0
EDGES = quantizer.embedded_edges(1, PLANES, STEP)
RESOLUTION = 4096


def coefficients(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bins, predictions and scales; a few predictions are far off."""
    rng = np.random.default_rng(seed)
    predicted = rng.normal(0.0, 60.0, count)
    scale = np.clip(np.exp(rng.normal(1.0, 1.0, count)), noise.MIN_SCALE, None)
    truth = predicted + rng.laplace(0.0, 1.0, count) * scale + 200.0 * (rng.random(count) < 0.1)
    bins = np.floor(truth / STEP + quantizer.embedded_origin(1, PLANES)).astype(np.int64)
    return np.clip(bins, 0, 2**PLANES - 1), predicted, scale


def integrated(lower: float, upper: float, predicted: float, scale: float, depth: int) -> np.ndarray:
    """Return entropy and lost variance of 1 to `depth` halvings of an interval, by sums over fine steps."""
    ends = np.linspace(lower, upper, RESOLUTION + 1)
    centres = (ends[1:] + ends[:-1]) / 2
    below, above = np.minimum(ends - predicted, 0.0), np.maximum(ends - predicted, 0.0)
    mass = 0.5 * (np.diff(np.exp(below / scale)) - np.diff(np.exp(-above / scale)))
    farther = np.exp(-max(lower - predicted, predicted - upper, 0.0) / scale)  # probability of such errors
    mass += (REFINEMENT_OUTLIER_PROBABILITY * farther + 1e-12) / RESOLUTION
    mass /= mass.sum()
    variance = np.sum(mass * (centres - np.sum(mass * centres)) ** 2)
    found = []
    for halvings in range(1, depth + 1):
        parts, points = mass.reshape(2**halvings, -1), centres.reshape(2**halvings, -1)
        shares = parts.sum(axis=1)
        means = np.sum(parts * points, axis=1) / shares
        within = np.sum(parts * (points - means[:, None]) ** 2)
        found.append((-np.sum(shares * np.log2(shares)), variance - within))
    return np.array(found)


@pytest.mark.parametrize("known", [0, 2, 4, 6])
def test_entropy_and_saving_are_those_of_the_density(known: int) -> None:
    """They agree with integration for each coefficient, near the prediction and far out in the tails."""
    bins, predicted, scale = coefficients(60)
    missing = PLANES - known
    prefix, depth = bins >> missing, min(missing, 2)
    expected = [
        integrated(EDGES[p << missing], EDGES[(p + 1) << missing], y, b, depth)
        for p, y, b in zip(prefix, predicted, scale, strict=True)
    ]
    worth = expected_refinement(prefix, missing, EDGES, predicted, scale, depth)
    bits, saved = np.moveaxis(expected, 0, -1).swapaxes(0, 1)
    np.testing.assert_allclose(worth.bits, bits, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(worth.saved, saved, rtol=1e-3, atol=1e-3)


def test_every_coefficient_stands_for_itself() -> None:
    prefix, predicted, scale = coefficients(50)
    together = expected_refinement(prefix >> 2, 2, EDGES, predicted, scale, 2)
    assert together.bits.shape == together.saved.shape == (2, 50)
    for n in range(50):
        own = slice(n, n + 1)
        alone = expected_refinement(prefix[own] >> 2, 2, EDGES, predicted[own], scale[own], 2)
        np.testing.assert_array_equal(alone.bits, together.bits[:, own])
        np.testing.assert_array_equal(alone.saved, together.saved[:, own])


def test_sure_planes_are_worth_nothing() -> None:
    """Where the prediction is known to lie well within a half, neither bits nor error are to be expected."""
    prefix, scale = np.zeros(100, np.int64), np.full(100, noise.MIN_SCALE)
    worth = expected_refinement(prefix, 1, np.array([0.0, 50.0, 100.0]), np.full(100, 20.0), scale, 1)
    assert worth.bits.max() < 0.002
    assert worth.saved.max() < 100**2 * REFINEMENT_OUTLIER_PROBABILITY


def test_bins_that_do_not_exist_count_nothing() -> None:
    edges = quantizer.bin_edges(8, 3.0)
    worth = expected_refinement(np.array([7]), 0, edges, np.zeros(1), np.ones(1), 0)
    assert worth.bits.size == worth.saved.size == 0
    worth = expected_refinement(np.array([3]), 1, edges, np.array([10.0]), np.ones(1), 1)
    assert worth.bits.shape == (1, 1)
    assert worth.bits[0, 0] < 1e-3


@pytest.mark.nojit
def test_kernel_equals_its_twin() -> None:
    bins, predicted, scale = coefficients(40, seed=1)
    results = []
    for function in (_kernels.refinement, python_twin(_kernels.refinement)):
        bits, saved = np.zeros((2, 2, bins.size))
        function(bins >> 3, 3, EDGES, predicted, scale, 2e-4, bits, saved)
        results.append((bits.tolist(), saved.tolist()))
        assert bits.min() >= 0.0
        assert saved.min() >= 0.0
        assert bits.sum(axis=1).min() > 0.0
        assert saved.sum(axis=1).min() > 0.0
    assert results[0] == results[1]
