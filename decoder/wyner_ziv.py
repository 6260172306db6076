"""Decoding of one Wyner-Ziv frame as a coroutine without I/O: it yields requests and is sent bits.

Bands are decoded in zigzag order, each plane by plane: the noise model turns side information and what is
known so far into log-likelihood ratios, the Slepian-Wolf decoder asks for parity until the plane is right,
and the conditional mean reconstructs the coefficients. What has been decoded teaches the rest: scales are
fitted to the decoded intervals, blocks that turned out worse than expected are expected to be bad in later
bands, and the side information is refined and fused with what it was at first.
"""

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from decoder.side_information.protocol import Prediction
from decoder.side_information.weighting import fuse
from decoder.tasks import BandCost, DecodedFrame
from dvc import turbo
from dvc.config import CodecConfig
from dvc.video import Frame
from dvc.wynerziv import bitplanes, noise, reconstruction, transform
from dvc.wynerziv.layout import FrameLayout, Quantization
from dvc.wynerziv.priors import LearnedPriors
from dvc.wynerziv.refinement import Refinement, expected_refinement

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]

REFINING_WIDTH = 4.0
"""Mean interval of the first band, in scales, below which each of its planes refines the side information."""
NUM_FITTED_PLANES = 5
"""Planes of a band after which the scale is fitted again; later planes tell little."""
ERROR_FLOOR = 0.15
"""Share of the bin width that counts as error even where the reconstruction agrees with the prediction."""
LOOK_AHEAD = 2
"""Planes of a band that are looked at together before the next is given up."""
REQUESTS = turbo.SlepianWolfSettings(
    initial_rate=0.9,
    early_rate=1.0,
    early_step=0.05,
    step=0.02,
    progress=0.95,
    min_step_bits=3,
    stuck_errors=0.98,
    stuck_step=0.03,
    stuck_iterations=2,
    search_work=0.0,
    uncoded_entropy=0.9,
)
"""Coarser steps than those that cost the fewest bits, and no search: a trade of rate for decoding time."""


FrameCoroutine = Generator[turbo.ParityRequest, Bits, DecodedFrame]


@dataclass
class _KnownBand:
    """What is known of a decoded band."""

    lower: Array
    upper: Array
    scale: Array

    @classmethod
    def of(cls, lower: Array, upper: Array, scale: Array, shape: tuple[int, int]) -> "_KnownBand":
        return cls(lower.reshape(shape), upper.reshape(shape), scale.reshape(shape))

    def reconstruct(self, side_information: Array) -> Array:
        return reconstruction.conditional_mean(self.lower, self.upper, side_information, self.scale)

    def error(self, side_information: Array) -> Array:
        """Expected magnitude of truth minus prediction, relative to its mean over the frame."""
        floor = ERROR_FLOOR * np.minimum(self.upper - self.lower, 4.0 * self.scale)
        error: Array = np.abs(self.reconstruct(side_information) - side_information) + floor
        return error / float(error.mean())


class _FrameState:
    """The frame as far as it is decoded: prediction, noise model, known bands."""

    def __init__(self, layout: FrameLayout, prediction: Prediction, model: str, initial_gain: float) -> None:
        self._layout = layout
        self._model = model
        self.known: dict[int, _KnownBand] = {}
        self.gain = initial_gain
        self._first = [transform.forward(luma) for luma in (prediction.luma, *prediction.alternatives)]
        self.expected_error = None
        if prediction.expected_error is not None:
            self.expected_error = np.maximum(transform.forward(prediction.expected_error)[0], noise.MIN_SCALE)
        self.prediction = prediction
        self.predicted = self._first[0]
        self.bands = self.predicted.copy()
        self.base_scale = noise.MODELS[model](transform.forward(_disagreement(prediction)))

    def use(self, prediction: Prediction) -> None:
        """Fuse new side information with the first, and reconstruct the known bands again with it."""
        lumas = (*prediction.compensated, prediction.luma)
        hypotheses = np.stack(self._first + [transform.forward(luma) for luma in lumas])
        self.predicted, spread = fuse(hypotheses, {band: self.bands[band] for band in self.known})
        self.base_scale = noise.MODELS[self._model](spread)
        luma = transform.inverse(self.predicted, self._layout.height, self._layout.width)
        self.prediction = replace(prediction, luma=luma)
        self.bands = self.predicted.copy()
        for band, known in self.known.items():
            self.bands[band] = known.reconstruct(self.predicted[band])

    def scale(self, band: int) -> Array:
        """Scale of each coefficient of a band before any of it is decoded."""
        base: Array = self.base_scale[band]
        texture = noise.texture(self.predicted, band)
        if not self.known:
            return noise.shaped(base, texture, self.expected_error)
        activity = np.zeros_like(base)
        for other, known in self.known.items():
            activity += _smoothed(known.error(self.predicted[other]))
        local = np.sqrt(base * base.mean() * (activity / len(self.known)))
        return noise.shaped(local, texture, None)

    def set_known(self, band: int, known: _KnownBand) -> None:
        self.known[band] = known
        self.bands[band] = known.reconstruct(self.predicted[band])

    def dc_error(self) -> Array | None:
        """By how much the DC band is off its prediction, once it is known."""
        error: Array = self.bands[0] - self.predicted[0]
        return error if 0 in self.known else None

    def correct(self, band: int, lower: Array, upper: Array) -> None:
        """Change the intervals of a band that is known."""
        self.set_known(band, _KnownBand.of(lower, upper, self.known[band].scale, self._layout.band_shape))

    def refine(self) -> None:
        """Refine the side information with what is known, where its method can."""
        if self.prediction.refiner is not None and self.known:
            self.use(self.prediction.refiner.refine(self.luma()))

    def refine_by_part(self, band: int, part: _KnownBand) -> None:
        """Refine the side information with a band of which some planes are missing still."""
        self.set_known(band, part)
        self.refine()
        del self.known[band]

    def luma(self) -> NDArray[np.uint8]:
        return transform.to_uint8(transform.inverse(self.bands, self._layout.height, self._layout.width))


def _smoothed(error: Array) -> Array:
    neighbourhood: Array = uniform_filter(error, 3, mode="nearest")
    return 0.5 * error + 0.5 * neighbourhood


def _disagreement(prediction: Prediction) -> Array:
    """Half the difference of the compensated references; of the two that differ most where there are more."""
    stack = np.stack(prediction.compensated)
    difference: Array = stack[0] - stack[1] if len(stack) == 2 else stack.max(axis=0) - stack.min(axis=0)
    return 0.5 * difference


def _cost(band: int, results: list[turbo.PlaneResult]) -> BandCost:
    ideal_bits = sum(result.ideal_bits for result in results)
    return BandCost(band, ideal_bits, sum(result.parity_bits + result.crc_bits for result in results))


def _pays(worth: Refinement, cost: turbo.PlaneCost, slope: float) -> bool:
    """Tell whether the next plane of a band, or the next few together, save `slope` for every bit."""
    ahead = enumerate(zip(worth.bits, worth.saved, strict=True), 1)
    return any(saved > slope * cost.bits(bits, planes) for planes, (bits, saved) in ahead)


class WynerZivDecoder:
    """Decodes Wyner-Ziv frames of one configuration; keeps turbo decoders between frames.

    Parameters
    ----------
    config : CodecConfig
        Configuration of the stream.
    """

    def __init__(self, config: CodecConfig) -> None:
        self.layout = FrameLayout.of(config)
        self._config = config
        settings = replace(
            REQUESTS,
            family=config.turbo.family,
            crc_bits=config.turbo.crc_bits,
            first_crc_bits=config.turbo.first_crc_bits,
            max_prior_llr=config.wyner_ziv.max_llr,
        )
        seed = config.turbo.interleaver_seed
        self._plane_decoder = turbo.plane_decoder(settings, self.layout.num_bits, seed)
        self._priors = LearnedPriors(self.layout.band_shape)

    def start_group(self) -> None:
        """Forget what was learned from frames of other groups of pictures."""
        self._priors = LearnedPriors(self.layout.band_shape)

    def decode(
        self, index: int, quantization: Quantization, prediction: Prediction, slope: float = 0.0
    ) -> FrameCoroutine:
        """Decode one frame.

        Parameters
        ----------
        index : int
            Display position, which requests carry.
        quantization : Quantization
            From the frame's header.
        prediction : Prediction
            Side information.
        slope : float, optional
            Squared error that a bit must save, or its plane is not asked for; 0: all planes are.

        Yields
        ------
        ParityRequest
            Bits wanted; send them as ndarray of shape (count,), uint8.

        Returns
        -------
        DecodedFrame
            The frame and what it cost.
        """
        settings = self._config.wyner_ziv
        state = _FrameState(self.layout, prediction, settings.noise_model, settings.initial_gain)
        decoded: dict[int, list[turbo.PlaneResult]] = {}
        check = turbo.FrameCheck()
        last = len(quantization.bands) - 1
        for position, band in enumerate(quantization.bands):
            decoded[band] = yield from self._decode_band(index, band, quantization, state, slope)
            if position == last:
                check = yield from self._plane_decoder.check(index)
                self._correct(check, decoded, quantization, state)
            if position in settings.refine_after or position == last:
                state.refine()
        results = [result for planes in decoded.values() for result in planes]
        refiner = state.prediction.refiner
        chroma = prediction.chroma if refiner is None else refiner.chroma()
        return DecodedFrame(
            index=index,
            frame=Frame(state.luma(), chroma),
            side_information=transform.to_uint8(prediction.luma),
            refined_side_information=transform.to_uint8(state.prediction.luma),
            method=prediction.method,
            reason=prediction.reason,
            num_requests=check.num_requests + sum(result.num_requests for result in results),
            crc_bits=check.crc_bits + sum(result.crc_bits for result in results),
            parity_bits=sum(result.parity_bits for result in results),
            num_failed_planes=sum(not result.success for result in results) + (not check.success),
            num_left_planes=quantization.num_planes - len(results),
            band_costs=tuple(_cost(band, planes) for band, planes in decoded.items() if planes),
        )

    def _decode_band(
        self, index: int, band: int, quantization: Quantization, state: _FrameState, slope: float
    ) -> Generator[turbo.ParityRequest, Bits, list[turbo.PlaneResult]]:
        edges = quantization.edges(band)
        planes, shape = quantization.planes[band], self.layout.band_shape
        refined = not state.known and 0 in self._config.wyner_ziv.refine_after
        predicted, scale = state.predicted[band].ravel(), state.scale(band).ravel()
        prefix = np.zeros(self.layout.num_bits, dtype=np.int64)
        lower, upper = bitplanes.prefix_borders(prefix, planes, edges)
        gain, results = state.gain, []
        for plane in range(planes):
            missing = planes - plane - 1
            if slope > 0:
                depth = min(missing + 1, LOOK_AHEAD)
                worth = expected_refinement(prefix, missing + 1, edges, predicted, scale * gain, depth)
                if not _pays(worth, self._plane_decoder.cost, slope):
                    break
            middle, _ = bitplanes.prefix_borders(2 * prefix + 1, missing, edges)
            place, borders = (quantization.first_plane[band] + plane, band, plane), (lower, middle, upper)
            result = yield from self._decode_plane(index, place, borders, predicted, scale * gain, state)
            results.append(result)
            prefix = 2 * prefix + result.bits
            lower, upper = bitplanes.prefix_borders(prefix, missing, edges)
            if plane < NUM_FITTED_PLANES or missing == 0:
                gain = noise.fit_gain(lower, upper, predicted, scale, gain if missing else state.gain)
            if refined and missing and np.mean(upper - lower) < REFINING_WIDTH * gain * np.mean(scale):
                state.refine_by_part(band, _KnownBand.of(lower, upper, scale * gain, shape))
                predicted, scale = state.predicted[band].ravel(), state.scale(band).ravel()
                gain = noise.fit_gain(lower, upper, predicted, scale, gain)
        if results:
            state.gain = float(np.sqrt(state.gain * gain))
            state.set_known(band, _KnownBand.of(lower, upper, scale * gain, shape))
        return results

    def _decode_plane(
        self,
        index: int,
        place: tuple[int, int, int],
        borders: tuple[Array, Array, Array],
        predicted: Array,
        scale: Array,
        state: _FrameState,
    ) -> Generator[turbo.ParityRequest, Bits, turbo.PlaneResult]:
        """Decode a plane; `place` is its number in the frame, its band, and its number in that."""
        number = index, place[0]
        if self._config.wyner_ziv.priors == "laplacian":
            llr = noise.bit_llr(*borders, predicted, scale)
            return (yield from self._plane_decoder.decode(llr, number))
        prior = self._priors.plane(place[1:], borders, predicted, scale, state.dc_error())
        result = yield from self._plane_decoder.decode(prior.llr, number, prior.coupling)
        self._priors.learn(prior, result.bits)
        return result

    def _correct(
        self,
        check: turbo.FrameCheck,
        decoded: dict[int, list[turbo.PlaneResult]],
        quantization: Quantization,
        state: _FrameState,
    ) -> None:
        """Put planes that the check of the frame has corrected in the place of those decoded before."""
        for band, results in decoded.items():
            first = quantization.first_plane[band]
            places = check.corrected.keys() & range(first, first + len(results))
            for place in places:
                results[place - first] = check.corrected[place]
            if places:
                prefix = bitplanes.from_planes(np.stack([result.bits for result in results]))
                missing = quantization.planes[band] - len(results)
                state.correct(band, *bitplanes.prefix_borders(prefix, missing, quantization.edges(band)))
