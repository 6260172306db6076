"""Priors that learn: corrections that fit, neighbours that tell, and numbers whatever the planes are."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from dvc.wynerziv import noise
from dvc.wynerziv import priors as priors_module
from dvc.wynerziv.priors import LearnedPriors, PlanePrior
from tests.reference.wynerziv import coupled_llr, newton

SHAPE = (40, 44)
ALL = np.arange(SHAPE[0] * SHAPE[1])
STEP = 8.0


def code_length(llr: np.ndarray, bits: np.ndarray) -> float:
    """Return the ideal code length in bits."""
    return float(np.logaddexp(0.0, np.where(bits == 1, llr, -llr)).sum() / np.log(2.0))


def planes(
    rng: np.random.Generator, error: np.ndarray, scale: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray, np.ndarray, np.ndarray]:
    """Return borders, side information, scales and bits of a plane of values with given errors."""
    predicted = rng.uniform(0.0, 100.0, error.size)
    true = predicted + error.ravel()
    lower = 2.0 * STEP * np.floor(true / (2.0 * STEP))
    bits = (true >= lower + STEP).astype(np.uint8)
    return (lower, lower + STEP, lower + 2.0 * STEP), predicted, np.full(error.size, scale), bits


def test_newton_steps_as_in_the_plain_way() -> None:
    rng = np.random.default_rng(1)
    inputs, offset = rng.normal(0.0, 1.0, (3, 500)), rng.normal(0.0, 0.5, 500)
    is_zero = (rng.random(500) < 1.0 / (1.0 + np.exp(-2.0 * inputs[0]))).astype(np.float64)
    start, precision = np.array([1.0, 0.0, 0.2]), np.diag([5.0, 9.0, 3.0])
    wanted, hessian = newton(inputs, offset, is_zero, start, precision, 2)
    for most in (9.0, 1.1):
        weights, found = start.copy(), precision.copy()
        limits = np.full(3, -9.0), np.full(3, most)
        priors_module._fit_logistic(inputs, offset, is_zero, *limits, 2, weights, found)
        if most == 9.0:
            np.testing.assert_allclose(weights, wanted, rtol=1e-9)
            np.testing.assert_allclose(found, hessian, rtol=1e-9)
        assert weights.max() <= most


HALF, OTHERS = ALL[: ALL.size // 2], ALL[ALL.size // 2 :]


@pytest.mark.parametrize(
    ("taught", "judged", "count"), [(ALL, ALL, 4), (HALF, OTHERS, 6)], ids=["all", "half"]
)
def test_wrong_scales_are_corrected(taught: np.ndarray, judged: np.ndarray, count: int) -> None:
    """If the noise model is far from the errors, bits cost less with every decoded plane, or half of one."""
    rng = np.random.default_rng(2)
    priors = LearnedPriors(SHAPE)
    ratios = []
    for _ in range(2 * count):
        borders, predicted, scale, bits = planes(rng, rng.laplace(0.0, 8.0, SHAPE), 2.0)
        llr = priors.plane((1, 1), borders, predicted, scale, None, judged).llr
        before = np.clip(noise.bit_llr(*borders, predicted, scale)[judged], -9.0, 9.0)
        own = bits[judged]
        ratios.append(code_length(np.clip(llr, -9.0, 9.0), own) / code_length(before, own))
        priors.learn(priors.plane((1, 1), borders, predicted, scale, None, taught), bits[taught])
    assert max(ratios[count:]) < 0.97
    assert np.mean(ratios[count:]) < np.mean(ratios[:2])


def test_smooth_errors_are_told_by_neighbours() -> None:
    """Where errors are alike in neighbouring blocks, those before it make a bit cheaper."""
    rng = np.random.default_rng(3)
    priors = LearnedPriors(SHAPE)
    alone = coupled = 0.0
    for number in range(6):
        error = 60.0 * uniform_filter(rng.normal(0.0, 1.0, SHAPE), 9) + rng.laplace(0.0, 0.7, SHAPE)
        borders, predicted, scale, bits = planes(rng, error, 4.0)
        prior = priors.plane((0, 1), borders, predicted, scale, None, ALL)
        if number > 2:
            alone += code_length(prior.llr, bits)
            coupled += code_length(prior.coupling.llr_given(bits, causal=True), bits)
        priors.learn(prior, bits)
    assert coupled < 0.98 * alone


@pytest.mark.parametrize(("band", "ends", "sides"), [(1, 1, 0), (2, 0, 1), (0, 1, 1)])
def test_neighbours_along_edges_count_the_most(band: int, ends: int, sides: int) -> None:
    """Blocks above and below lie along the edges of horizontal frequencies, those at the sides across."""
    rng = np.random.default_rng(4)
    borders, predicted, scale, _ = planes(rng, rng.laplace(0.0, 4.0, SHAPE), 4.0)
    weights = LearnedPriors(SHAPE).plane((band, 1), borders, predicted, scale, None, ALL).coupling.weights
    usual = weights[:, :2].max()
    assert weights.shape == (SHAPE[0], 3)
    np.testing.assert_array_equal(weights[:, :2] == usual, np.tile([bool(sides), bool(ends)], (SHAPE[0], 1)))


def test_ramps_of_dc_errors_tell_first_frequencies() -> None:
    """A prediction too dark on the left raises the expected horizontal frequency, not the vertical."""
    rng = np.random.default_rng(5)
    borders, predicted, scale, _ = planes(rng, rng.laplace(0.0, 4.0, SHAPE), 4.0)
    ramp = np.tile(-4.0 * np.arange(SHAPE[1], dtype=np.float64), (SHAPE[0], 1))
    for band, moved in ((1, True), (2, False)):
        plain = LearnedPriors(SHAPE).plane((band, 1), borders, predicted, scale, None, ALL).llr
        found = LearnedPriors(SHAPE).plane((band, 1), borders, predicted, scale, ramp, ALL).llr
        assert np.mean(found - plain) < -0.1 if moved else np.array_equal(found, plain)


def test_errors_around_make_bits_less_sure() -> None:
    """Beside blocks whose predictions were wrong, some too high and some too low, LLRs are smaller."""
    predicted = np.full(SHAPE, 50.0)
    predicted[::2, :22], predicted[1::2, :22] = 68.0, 20.0  # outside the interval, equally far
    borders = (np.full(predicted.size, 32.0), np.full(predicted.size, 48.0), np.full(predicted.size, 56.0))
    scale = np.full(predicted.size, 4.0)
    llr = LearnedPriors(SHAPE).plane((0, 1), borders, predicted.ravel(), scale, None, ALL).llr.reshape(SHAPE)
    beside, far = np.abs(llr[4:-4, 23]), np.abs(llr[4:-4, 30])
    assert beside.mean() < 0.95 * far.mean()


@pytest.mark.parametrize("width", [0.0, 1e-9, 1e6])
@pytest.mark.parametrize("blocks", [ALL, ALL[::7], ALL[:1]], ids=["all", "some", "one"])
def test_planes_of_any_kind_give_numbers(width: float, blocks: np.ndarray) -> None:
    """Bins without width, or far away from the prediction, and bits that nobody expects, are borne."""
    rng = np.random.default_rng(6)
    size = SHAPE[0] * SHAPE[1]
    lower = rng.uniform(-1e6, 1e6, size)
    borders = lower, lower + 0.5 * width, lower + width
    priors = LearnedPriors(SHAPE)
    for band in (0, 1, 5, 15) * 3:
        scale = rng.choice([0.3, 1e4], size)
        prior = priors.plane(
            (band, 1), borders, rng.uniform(-1e4, 1e4, size), scale, rng.normal(0, 1e5, SHAPE), blocks
        )
        assert _is_sound(prior)
        priors.learn(prior, rng.integers(0, 2, blocks.size, dtype=np.uint8))


def plain_terms(prior: PlanePrior, bits: np.ndarray, weights: list[float]) -> np.ndarray:
    """Return what LLRs gain by neighbours, some of which have bits, where all are known."""
    coupling = replace(prior.coupling, weights=np.tile(weights, (SHAPE[0], 1)))
    believed = np.zeros(ALL.size)
    believed[coupling.places] = bits
    gained = coupled_llr(coupling, believed.reshape(SHAPE), False) - coupling.base
    return np.clip(gained.ravel()[coupling.places], -12.0, 12.0)


@pytest.mark.parametrize("band", [0, 1, 2])
def test_some_blocks_are_known_as_all_are(band: int) -> None:
    """LLRs and their terms are those of the blocks among all; neighbours tell where they have bits."""
    rng = np.random.default_rng(8)
    borders, predicted, scale, bits = planes(rng, rng.laplace(0.0, 6.0, SHAPE), 4.0)
    blocks = np.sort(rng.permutation(ALL.size)[:900])
    ramp = rng.normal(0.0, 3.0, SHAPE)
    whole, some = (
        LearnedPriors(SHAPE).plane((band, 1), borders, predicted, scale, ramp, own) for own in (ALL, blocks)
    )
    np.testing.assert_array_equal(some.llr, whole.llr[blocks])
    np.testing.assert_array_equal(some.inputs, whole.inputs[:, blocks])
    np.testing.assert_array_equal(some.coupling.places, blocks)
    for prior in (whole, some):
        own = bits[prior.coupling.places]
        sides, ends = plain_terms(prior, own, [1.0, 0.0, 0.0]), plain_terms(prior, own, [0.0, 1.0, 0.0])
        along, across = {0: (sides + ends, 0.0 * sides), 1: (ends, sides), 2: (sides, ends)}[band]
        spread = plain_terms(prior, own, [0.0, 0.0, 1.0])
        found = priors_module._coupled_inputs(prior, own)
        np.testing.assert_allclose(found, np.stack([along, across, spread]), atol=1e-4)


def _is_sound(prior: PlanePrior) -> bool:
    told = prior.coupling.llr_given(np.ones(prior.llr.size, np.float32), causal=False)
    return bool(np.isfinite(told).all() and np.abs(prior.llr).max() <= 12.0)


def test_what_was_learned_side_by_side_is_averaged() -> None:
    """The mean of one is the same, that of two lies between them, and neither changes with the mean."""
    rng = np.random.default_rng(5)
    several = [LearnedPriors(SHAPE), LearnedPriors(SHAPE)]
    borders, predicted, scale, bits = planes(rng, rng.laplace(0.0, 8.0, SHAPE), 2.0)

    def llr(priors: LearnedPriors) -> np.ndarray:
        return priors.plane((1, 1), borders, predicted, scale, None, ALL).coupling.base

    several[0].learn(several[0].plane((1, 1), borders, predicted, scale, None, ALL), bits)
    before = [llr(priors) for priors in several]
    np.testing.assert_array_equal(llr(LearnedPriors.mean(several[:1])), before[0])
    mean = LearnedPriors.mean(several)
    np.testing.assert_allclose(llr(mean), (before[0] + before[1]) / 2.0, atol=1e-9)
    mean.learn(mean.plane((1, 1), borders, predicted, scale, None, ALL), bits)
    for priors, wanted in zip(several, before, strict=True):
        np.testing.assert_array_equal(llr(priors), wanted)
