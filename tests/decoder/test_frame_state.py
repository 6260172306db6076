"""What is known of a frame as its bands come: reconstruction, and where errors are expected."""

import weakref
from dataclasses import replace

import numpy as np
import pytest

from decoder.frame_state import INITIAL_GAIN, Band, FrameState, KnownBand
from decoder.side_information.protocol import Prediction
from dvc.config import CodecConfig, VideoConfig
from dvc.wynerziv import quantizer, transform
from dvc.wynerziv.quantizer import FrameLayout
from tests.clips import moving_texture

HEIGHT, WIDTH = 32, 48
LUMA = moving_texture(1, HEIGHT, WIDTH)[0].luma.astype(np.float64)
TRUTH = transform.forward(LUMA)
LAYOUT = FrameLayout.of(CodecConfig(VideoConfig(WIDTH, HEIGHT, 25, 1)))


class Refiner:
    """Tells what the frame is from what is known of it."""

    def __init__(self) -> None:
        self.given: list[np.ndarray] = []

    def refine(self, luma: np.ndarray) -> Prediction:
        self.given.append(luma)
        return Prediction(LUMA, None, (LUMA, LUMA), "refined", refiner=self)


def predicted(offset: float = 12.0, refiner: Refiner | None = None, **more: np.ndarray) -> Prediction:
    """Return a prediction that is off by a constant in its left half."""
    luma = LUMA.copy()
    luma[:, : WIDTH // 2] += offset
    return Prediction(luma, None, (luma + 2.0, luma - 2.0), "test", refiner=refiner, **more)  # type: ignore[arg-type]


def band_of(state: FrameState, band: int, width: float) -> KnownBand:
    """Return what bins of some width tell of a band."""
    lower = width * np.floor(TRUTH[band] / width)
    return KnownBand(lower, lower + width, state.scale(band))


def test_nothing_known_is_the_prediction() -> None:
    state = FrameState(LAYOUT, predicted(), "local")
    assert np.abs(state.luma() - predicted().luma).max() <= 1.0
    assert state.gain == INITIAL_GAIN
    assert state.dc_error() is None


def test_what_it_is_predicted_from_is_not_kept() -> None:
    prediction = predicted(refiner=Refiner())
    planes = [weakref.ref(plane) for plane in (prediction.luma, *prediction.compensated)]
    state = FrameState(LAYOUT, prediction, "local")
    state.set_known(0, band_of(state, 0, 8.0))
    del prediction
    assert not any(plane() is not None for plane in planes)
    state.refine()
    assert (state.side_information != state.luma(state.predicted)).any()


def test_bands_that_are_known_are_in_their_bins() -> None:
    state = FrameState(LAYOUT, predicted(), "local")
    known = band_of(state, 0, 8.0)
    state.set_known(0, known)
    assert (state.bands[0] >= known.lower).all()
    assert (state.bands[0] <= known.upper).all()
    error = state.dc_error()
    assert error is not None
    left, right = np.split(error, 2, axis=1)
    missing = np.split(TRUTH[0] - state.predicted[0], 2, axis=1)[0].mean()
    assert left.mean() == pytest.approx(missing, rel=0.1)
    assert np.abs(right).mean() < 0.2 * np.abs(left).mean()
    before, after = (np.abs(luma - LUMA).mean() for luma in (predicted().luma, state.luma()))
    assert after < 0.3 * before


def test_errors_of_bands_tell_scales_of_others() -> None:
    state = FrameState(LAYOUT, predicted(), "frame")
    before = state.scale(3)
    state.set_known(0, band_of(state, 0, 4.0))
    left, right = np.split(state.scale(3) / before, 2, axis=1)
    assert np.median(left) > 1.5 * np.median(right)
    expected = np.ones((HEIGHT, WIDTH))
    expected[: HEIGHT // 2] = 9.0
    told = FrameState(LAYOUT, predicted(expected_error=expected), "frame")
    upper, lower = np.split(told.scale(3) / before, 2, axis=0)
    assert np.median(upper) == pytest.approx(3.0 * np.median(lower), rel=0.2)


def test_corrections_replace_intervals() -> None:
    state = FrameState(LAYOUT, predicted(), "local")
    known = band_of(state, 0, 16.0)
    state.set_known(0, known)
    lower = 2.0 * np.floor(TRUTH[0] / 2.0)
    state.set_known(0, replace(known, lower=lower, upper=lower + 2.0))
    assert np.abs(state.bands[0] - TRUTH[0]).max() <= 2.0
    np.testing.assert_array_equal(state.known[0].scale, known.scale)


def test_refined_predictions_are_fused_with_the_first() -> None:
    refiner = Refiner()
    state = FrameState(LAYOUT, predicted(refiner=refiner), "local")
    state.refine()
    assert not refiner.given  # nothing is known yet
    state.set_known(0, band_of(state, 0, 32.0))
    state.refine()
    del state.known[0]
    assert len(refiner.given) == 1
    assert not state.known
    state.set_known(0, band_of(state, 0, 8.0))
    state.refine()
    assert len(refiner.given) == 2
    assert (
        np.abs(state.predicted - TRUTH).mean()
        < 0.5 * np.abs(transform.forward(predicted().luma) - TRUTH).mean()
    )
    assert (state.bands[0] >= state.known[0].lower).all()


def test_references_that_differ_widen_the_scales() -> None:
    luma = predicted().luma
    two, three = (
        FrameState(LAYOUT, Prediction(luma, None, tuple(luma + d for d in apart), "test"), "frame").base_scale
        for apart in ((6.0, -6.0), (6.0, 1.0, -6.0))
    )
    none = FrameState(LAYOUT, Prediction(luma, None, (luma, luma), "test"), "frame").base_scale
    np.testing.assert_allclose(two, three)
    assert two.min() > none.max()


SHAPE = (6, 8)
STEP, PLANES = 8.0, 5


@pytest.fixture
def band() -> Band:
    """Return a band of which nothing is known, predicted with some noise."""
    rng = np.random.default_rng(1)
    count = SHAPE[0] * SHAPE[1]
    edges = quantizer.embedded_edges(1, PLANES, STEP)
    prefix = np.zeros(count, np.int64)
    lower, upper = quantizer.prefix_borders(prefix, PLANES, edges)
    return Band(
        1, PLANES, 7, edges, rng.normal(0.0, 20.0, count), np.full(count, 3.0), 1.3, 1.3, SHAPE,
        prefix, np.zeros(count, np.int64), np.arange(count), lower, upper,
    )  # fmt: skip


def bits_of(band: Band, truth: np.ndarray, missing: int) -> np.ndarray:
    origin = quantizer.embedded_origin(1, PLANES)
    bins = np.clip(np.floor(truth / STEP + origin), 0, 2**PLANES - 1).astype(np.int64)
    found: np.ndarray = (bins >> missing & 1).astype(np.uint8)
    return found


def test_intervals_close_in_on_values(band: Band) -> None:
    rng = np.random.default_rng(2)
    truth = band.predicted + rng.laplace(0.0, 4.0, band.predicted.size)
    width = band.upper - band.lower
    blocks = np.arange(truth.size)
    for missing in reversed(range(PLANES)):
        blocks = blocks[rng.random(blocks.size) < 0.8]
        assert band.place(missing) == (1, PLANES - missing - 1)
        band.take(blocks, bits_of(band, truth, missing)[blocks], missing)
        width[blocks] /= 2
        np.testing.assert_allclose(band.upper - band.lower, width)
        assert (band.lower <= truth)[blocks].all()
        assert (truth < band.upper)[blocks].all()
        np.testing.assert_array_equal(band.open, blocks)
    assert band.num_taken == PLANES


def test_what_bits_take_off_is_what_means_move(band: Band) -> None:
    truth = np.where(np.arange(band.predicted.size) < 10, band.predicted + 90.0, band.predicted)
    before = band.known.reconstruct(band.predicted.reshape(SHAPE))
    gain = band.gain
    saved = band.take(np.arange(truth.size), bits_of(band, truth, PLANES - 1), PLANES - 1)
    band.gain = gain
    after = band.known.reconstruct(band.predicted.reshape(SHAPE))
    assert saved == pytest.approx(np.sum((after - before) ** 2))
    assert saved > 0.0


def test_scales_are_fitted_to_what_is_known(band: Band) -> None:
    truth = band.predicted + 25.0 * (-1.0) ** np.arange(band.predicted.size)
    for missing in reversed(range(PLANES)):
        band.take(np.arange(truth.size), bits_of(band, truth, missing), missing)
    assert band.gain > 3.0


def test_planes_that_are_entered_again_replace_wrong_ones(band: Band) -> None:
    rng = np.random.default_rng(3)
    truth = band.predicted + rng.laplace(0.0, 9.0, band.predicted.size)
    taken = []
    for missing in reversed(range(PLANES)):
        blocks = band.open[rng.random(band.open.size) < 0.9]
        bits = bits_of(band, truth, missing)[blocks]
        taken.append((blocks, bits))
        wrong = bits.copy()
        wrong[0] ^= missing == 2
        band.take(blocks, wrong, missing)
    wrong_lower = band.lower.copy()
    band.forget()
    np.testing.assert_array_equal(band.upper - band.lower, STEP * 2**PLANES)
    for blocks, bits in taken:
        band.enter(blocks, bits)
    assert (band.lower != wrong_lower).any()
    known = band.depth == PLANES
    assert known.sum() > 20
    assert ((band.lower <= truth) & (truth < band.upper))[known].all()
