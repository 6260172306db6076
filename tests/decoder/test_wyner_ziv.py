"""Decoding of one Wyner-Ziv frame, answers taken from the encoder's bits in memory."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from unittest import mock

import numpy as np
import pytest

from decoder.frame_state import FrameState, KnownBand
from decoder.group_tasks import DecodedFrame
from decoder.side_information.protocol import Prediction
from decoder.wyner_ziv import FrameCoroutine, WynerZivDecoder, decode_level
from dvc.config import (
    CODERS,
    NOISE_MODELS,
    CodecConfig,
    DiscoverMatrix,
    VideoConfig,
    WynerZivConfig,
    codec_config,
)
from dvc.metrics import psnr_db
from dvc.slepian_wolf import CRC_BITS, Answer, Part, Round, drive, plane_coder
from dvc.video import Frame
from dvc.wynerziv import quantizer, transform
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout, Quantization
from tests.clips import moving_texture
from tests.reference.wynerziv import quantize

HEIGHT, WIDTH = 30, 44


def config_of(q: int, coder: str = "turbo") -> CodecConfig:
    return codec_config(
        VideoConfig(WIDTH, HEIGHT, 25, 1), "2d", DiscoverMatrix(q), coder=CODERS[coder](), seed=1
    )


def decode(
    config: CodecConfig,
    original: Frame,
    prediction: Prediction,
    step: float = 1.0,
    slope: float = 0.0,
    seen: Callable[[Round], None] = lambda _: None,
) -> DecodedFrame:
    encoded = EncodedFrame.of(FrameLayout.of(config), original.luma, step)
    decoder = WynerZivDecoder(config)
    quantization = decoder.layout.read_header(encoded.header)
    answer, finest = answering(config, encoded), quantization.step(0) or 1.0

    def _answer(requests: Round) -> Sequence[np.ndarray]:
        seen(requests)
        return answer(requests)

    with mock.patch.object(quantizer, "LAMBDA_PER_SQUARED_STEP", slope / finest**2):
        steps = decoder.decode(5, quantization, prediction, decoder.nothing_learned())
        return alone(decoder, steps, _answer)


def alone(decoder: WynerZivDecoder, frame: FrameCoroutine, answer: Answer) -> DecodedFrame:
    planes = decoder.coder.decoder(decoder.layout.num_bits)
    (decoded,) = drive(decode_level({5: frame}, planes, decoder.coder.by_positions), answer)
    return decoded


def answering(config: CodecConfig, encoded: EncodedFrame) -> Answer:
    buffer = EncoderBuffer(encoded.layout, plane_coder(config), 1)
    buffer.enter(0, encoded)
    return partial(buffer.answer_round, first_frame=5)


def noisy_prediction(original: Frame, noise: float, seed: int = 0) -> Prediction:
    """Return side information with Laplacian errors, and references that differ about as much."""
    rng = np.random.default_rng(seed)
    error, difference = (gain * rng.laplace(0.0, 1.0, original.luma.shape) for gain in (noise, noise))
    luma = np.clip(original.luma + error, 0.0, 255.0)
    return Prediction(luma, None, (luma + difference, luma - difference), "test")


def bins_of(quantization: Quantization, luma: np.ndarray) -> list[np.ndarray]:
    bands = transform.forward(luma).reshape(transform.NUM_BANDS, -1)
    return [quantize(bands[band], quantization.edges(band)) for band in quantization.bands]


def num_planes_of(config: CodecConfig) -> int:
    return sum(config.wyner_ziv.max_planes)


@pytest.fixture(scope="module")
def original() -> Frame:
    """Return the frame that is decoded everywhere below."""
    return moving_texture(1, HEIGHT, WIDTH)[0].without_chroma()


@pytest.mark.parametrize("q", [1, 4, 8])
@pytest.mark.parametrize("coder", CODERS)
def test_every_bin_is_decoded(original: Frame, q: int, coder: str) -> None:
    config = config_of(q, coder)
    decoded = decode(config, original, noisy_prediction(original, 4.0))
    assert decoded.num_failed_planes == 0
    quantization = EncodedFrame.of(FrameLayout.of(config), original.luma).quantization
    wanted, got = (bins_of(quantization, luma) for luma in (original.luma, decoded.frame.luma))
    same = np.mean([np.mean(a == b) for a, b in zip(wanted, got, strict=True)])
    assert same > 0.9  # rounding to whole samples moves a few coefficients across a border
    paid = sum(cost.bits for cost in decoded.band_costs)
    ideal = sum(cost.ideal_bits for cost in decoded.band_costs)
    assert [cost.band for cost in decoded.band_costs] == [
        band for band, planes in enumerate(config.wyner_ziv.max_planes) if planes
    ]
    assert 0 < ideal < paid <= decoded.parity_bits + decoded.crc_bits
    assert (paid == decoded.parity_bits + decoded.crc_bits) == (coder != "cascade")


def test_decoding_improves_side_information_at_a_cost_that_grows_with_noise(original: Frame) -> None:
    costs = []
    for noise in (0.5, 3.0, 10.0):
        decoded = decode(config_of(8), original, noisy_prediction(original, noise))
        before = psnr_db(decoded.side_information, original.luma)
        assert psnr_db(decoded.frame.luma, original.luma) > before
        np.testing.assert_array_equal(decoded.side_information, decoded.refined_side_information)
        costs.append(decoded.parity_bits)
    assert costs[0] < costs[1] < costs[2]


def test_perfect_side_information_costs_little_but_checks(original: Frame) -> None:
    perfect = Prediction(original.luma.astype(float), None, (original.luma.astype(float),), "test")
    config = config_of(4)
    decoded = decode(config, original, perfect)
    layout = FrameLayout.of(config)
    assert decoded.num_failed_planes == 0
    assert decoded.crc_bits <= CRC_BITS * num_planes_of(config)
    assert decoded.parity_bits < 0.1 * num_planes_of(config) * layout.num_bits


def test_useless_side_information_costs_at_most_twice_the_bits(original: Frame) -> None:
    config = config_of(3)
    layout = FrameLayout.of(config)
    other = moving_texture(1, HEIGHT, WIDTH, seed=9)[0].luma.astype(float)
    for confident in (other, 255.0 - other):
        decoded = decode(config, original, Prediction(confident, None, (confident, other), "test"))
        assert decoded.num_failed_planes == 0
        assert decoded.parity_bits <= 2 * num_planes_of(config) * layout.num_bits
        assert psnr_db(decoded.frame.luma, original.luma) > 20


@pytest.mark.parametrize("model", NOISE_MODELS)
def test_every_noise_model_decodes(original: Frame, model: str) -> None:
    config = config_of(4)
    config = replace(config, wyner_ziv=replace(config.wyner_ziv, noise_model=model))
    assert decode(config, original, noisy_prediction(original, 3.0)).num_failed_planes == 0


def test_requests_name_frame_run_and_range(original: Frame) -> None:
    config = config_of(2)
    ends: dict[tuple[int, str], int] = {}

    def _seen(requests: Round) -> None:
        for request in requests:
            assert request.frame == 5
            assert request.start == ends.get((request.run, request.kind), 0)
            ends[request.run, request.kind] = request.start + request.count

    decoded = decode(config, original, noisy_prediction(original, 3.0), seen=_seen)
    quantization = EncodedFrame.of(FrameLayout.of(config), original.luma).quantization
    assert {run for run, _ in ends} == set(range(quantization.num_planes))
    assert sum(count for (_, kind), count in ends.items() if kind == "crc") == decoded.crc_bits
    assert sum(count for (_, kind), count in ends.items() if kind != "crc") == decoded.parity_bits


def runs_of(config: CodecConfig, original: Frame, prediction: Prediction, slope: float) -> list[Part]:
    """Return the runs that a frame is decoded by alone, in order."""
    runs: list[Part] = []

    def _seen(requests: Round) -> None:
        runs.extend(part for request in requests for part in request.begun or ())

    decode(config, original, prediction, 8.0, slope, _seen)
    return runs


def test_bands_between_refinements_are_runs(original: Frame) -> None:
    """The first three bands are alone; of the next two, the next four and the rest, equal bins are a run."""
    config = _learning(embedded_config(), "cascade")
    runs = runs_of(config, original, noisy_prediction(original, 2.5), 0.0)
    quantization = EncodedFrame.of(FrameLayout.of(config), original.luma, 8.0).quantization
    planes, first = quantization.planes, quantization.first_plane
    parts = [
        quantization.bands[start:end] for start, end in ((0, 1), (1, 2), (2, 3), (3, 5), (5, 9), (9, 16))
    ]
    assert runs == [
        Part(0, tuple(first[band] + planes[band] - missing - 1 for band in part if planes[band] > missing))
        for part in parts
        for missing in reversed(range(max(planes[band] for band in part)))
    ]


def test_bits_are_asked_for_in_areas_that_are_badly_predicted() -> None:
    original = moving_texture(1, 96, 160)[0].without_chroma()
    config = _learning(replace(embedded_config(), video=VideoConfig(160, 96, 25, 1)), "cascade")
    prediction = noisy_prediction(original, 0.5)
    wrong = noisy_prediction(original, 25.0)
    for plane, other in (
        (prediction.luma, wrong.luma),
        *zip(prediction.compensated, wrong.compensated, strict=True),
    ):
        plane[:48, :64] = other[:48, :64]
    areas = Areas((24, 40))
    runs = runs_of(config, original, prediction, 100.0)
    assert len(runs) > 5
    chosen = np.mean([areas.decoded(run.areas).reshape(areas.shape) for run in runs], axis=0)
    assert chosen[:3, :4].mean() > 0.8
    assert chosen[4:, 5:].mean() < 0.3


def test_a_frame_whose_means_are_right_is_decoded(original: Frame) -> None:
    config = _learning(embedded_config(), "cascade")
    bands = transform.forward(original.luma)
    bands[1:] += np.random.default_rng(3).laplace(0.0, 20.0, bands[1:].shape)
    luma = transform.inverse(bands, HEIGHT, WIDTH)
    prediction = Prediction(luma, None, (luma, luma - 0.5), "test")
    runs = runs_of(config, original, prediction, 60.0)
    quantization = EncodedFrame.of(FrameLayout.of(config), original.luma, 8.0).quantization
    assert min(run.planes[0] for run in runs) >= quantization.planes[0]
    assert any(len(run.planes) > 1 for run in runs)


NESTED = WynerZivConfig(priors="laplacian")


def embedded_config() -> CodecConfig:
    return replace(config_of(1), wyner_ziv=NESTED)


@pytest.mark.parametrize("step", [2.0, 12.0, 700.0])
def test_embedded_bins_are_decoded(original: Frame, step: float) -> None:
    config = embedded_config()
    decoded = decode(config, original, noisy_prediction(original, 4.0), step)
    assert decoded.num_failed_planes == 0
    assert decoded.num_skipped_planes == 0
    error = decoded.frame.luma.astype(float) - original.luma
    assert np.mean(error**2) < step**2 / 6 + 0.5


@pytest.mark.parametrize("coder", CODERS)
def test_a_frame_without_planes_that_pay_is_left_as_predicted(original: Frame, coder: str) -> None:
    config = replace(embedded_config(), coder=CODERS[coder]())
    black = Frame(np.zeros_like(original.luma))
    assert EncodedFrame.of(FrameLayout.of(config), black.luma, 8.0).quantization.num_planes == 0
    for frame, step, slope in ((black, 8.0, 0.0), (original, 4.0, 1e6)):
        decoded = decode(config, frame, noisy_prediction(frame, 2.0), step, slope)
        assert (
            decoded.num_requests == decoded.crc_bits == decoded.parity_bits == decoded.num_failed_planes == 0
        )
        assert (decoded.num_skipped_planes == 0) == (frame is black)
        np.testing.assert_array_equal(decoded.frame.luma, decoded.side_information)


def test_a_steeper_slope_asks_for_less(original: Frame) -> None:
    config = embedded_config()
    prediction = noisy_prediction(original, 6.0)
    found = [decode(config, original, prediction, 4.0, slope) for slope in (0.0, 20.0, 100.0, 1e3)]
    bits = [decoded.crc_bits + decoded.parity_bits for decoded in found]
    quality = [psnr_db(decoded.frame.luma, original.luma) for decoded in found]
    left = [decoded.num_skipped_planes for decoded in found]
    assert bits == sorted(bits, reverse=True)
    assert bits[-1] < bits[0] / 2
    assert quality == sorted(quality, reverse=True)
    assert left == sorted(left)
    assert left[0] == 0 < left[-1]


def test_bits_are_asked_for_where_they_pay() -> None:
    """A bit saves about the slope or more on the average; the first ones save the most."""
    original = moving_texture(1, 96, 160)[0].without_chroma()
    config = replace(embedded_config(), video=VideoConfig(160, 96, 25, 1))
    prediction = noisy_prediction(original, 12.0)
    found = [decode(config, original, prediction, 8.0, slope) for slope in (1e6, 200.0, 50.0)]
    error = [float(np.sum((d.frame.luma.astype(float) - original.luma) ** 2)) for d in found]
    bits = [d.crc_bits + d.parity_bits for d in found]
    first, more = -np.diff(error) / np.diff(bits)
    assert first > 150.0
    assert 40.0 < more < first


def _learning(config: CodecConfig, coder: str) -> CodecConfig:
    learned = replace(config.wyner_ziv, priors="learned")
    return replace(config, wyner_ziv=learned, coder=CODERS[coder]())


@pytest.mark.parametrize("coder", CODERS)
def test_learned_priors_decode_the_same_bins(
    original: Frame, coder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    borders: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    set_known = FrameState.set_known

    def _set_known(state: FrameState, band: int, known: KnownBand) -> None:
        borders[band] = known.lower.ravel(), known.upper.ravel()
        set_known(state, band, known)

    monkeypatch.setattr(FrameState, "set_known", _set_known)
    prediction = noisy_prediction(original, 5.0)
    plain = decode(embedded_config(), original, prediction, 8.0)
    bins = dict(borders)
    learned = decode(_learning(embedded_config(), coder), original, prediction, 8.0)
    assert plain.num_failed_planes == learned.num_failed_planes == 0
    assert len(bins) > 10
    assert borders.keys() == bins.keys()
    for band, (lower, upper) in bins.items():
        np.testing.assert_array_equal(borders[band][0], lower)
        np.testing.assert_array_equal(borders[band][1], upper)


def test_every_group_learns_by_itself(original: Frame) -> None:
    """What was learned from other frames changes what a frame costs, until a new group starts."""
    config = _learning(embedded_config(), "cascade")
    encoded = EncodedFrame.of(FrameLayout.of(config), original.luma, 8.0)
    decoder = WynerZivDecoder(config)
    quantization = decoder.layout.read_header(encoded.header)
    prediction = noisy_prediction(original, 5.0)
    costs, learned, answer = [], decoder.nothing_learned(), answering(config, encoded)
    for number in range(3):
        if number == 2:
            learned = decoder.nothing_learned()
        steps = decoder.decode(5, quantization, prediction, learned)
        decoded = alone(decoder, steps, answer)
        costs.append([cost.ideal_bits for cost in decoded.band_costs])
    assert costs[0] == costs[2] != costs[1]
