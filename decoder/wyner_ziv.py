"""Decoding of one Wyner-Ziv frame as a coroutine without I/O: it yields requests and is sent bits.

Bands are decoded in zigzag order, each plane by plane: the noise model turns side information and what is
known so far into log-likelihood ratios, the Slepian-Wolf decoder asks for parity until the plane is right,
and the conditional mean reconstructs the coefficients. What has been decoded teaches the rest: scales are
fitted to the decoded intervals, blocks that turned out worse than expected are expected to be bad in later
bands, and the side information is refined and fused with what it was at first. Bands between two refinements
are decoded side by side: what they ask for goes together.
"""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from decoder.allowances import Allowance
from decoder.frame_state import FrameState, KnownBand
from decoder.side_information.protocol import Prediction
from decoder.tasks import BandCost, DecodedFrame
from dvc import slepian_wolf
from dvc.config import CodecConfig
from dvc.wynerziv import noise, quantizer
from dvc.wynerziv.priors import LearnedPriors
from dvc.wynerziv.quantizer import FrameLayout, Quantization
from dvc.wynerziv.refinement import Refinement, expected_refinement

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]

REFINE_AFTER = (0, 1, 2, 4, 8)
"""Positions of bands in coding order after which the side information is refined, beside the last one."""
REFINING_WIDTH = 4.0
"""Mean interval of the first band, in scales, below which each of its planes refines the side information."""
NUM_FITTED_PLANES = 5
"""Planes of a band after which the scale is fitted again; later planes tell little."""
LOOK_AHEAD = 2
"""Planes of a band that are looked at together before the next is given up."""


FrameCoroutine = Generator[slepian_wolf.Round, Sequence[Bits], DecodedFrame]
BandCoroutine = Generator[slepian_wolf.ParityRequest, Bits, "DecodedBand"]


@dataclass(frozen=True)
class DecodedBand:
    """A band as far as its planes were asked for."""

    planes: list[slepian_wolf.PlaneResult]
    gain: float  # factor on the scale of the noise
    known: KnownBand


def _cost(band: int, results: list[slepian_wolf.PlaneResult]) -> BandCost:
    ideal_bits = sum(result.ideal_bits for result in results)
    return BandCost(band, ideal_bits, sum(result.parity_bits + result.crc_bits for result in results))


def _between_refinements(bands: Sequence[int]) -> Iterator[Sequence[int]]:
    """Divide bands, in coding order, where the side information is refined."""
    ends = [0, *(position + 1 for position in REFINE_AFTER if position + 1 < len(bands)), len(bands)]
    return (bands[first:end] for first, end in pairwise(ends) if first < end)


def _is_worth_its_rate(worth: Refinement, cost: slepian_wolf.PlaneCost, multiplier: float) -> bool:
    """Tell whether the next plane of a band, or the next few together, save `multiplier` for every bit."""
    ahead = enumerate(zip(worth.bits, worth.saved, strict=True), 1)
    return any(saved > multiplier * cost.bits(bits, planes) for planes, (bits, saved) in ahead)


class WynerZivDecoder:
    """Decodes Wyner-Ziv frames of one configuration, also several side by side."""

    def __init__(self, config: CodecConfig) -> None:
        self.layout = FrameLayout.of(config)
        self._config = config
        self._coder = slepian_wolf.plane_coder(config)

    def new_priors(self) -> LearnedPriors:
        """Return what is known of priors before anything is decoded."""
        return LearnedPriors(self.layout.band_shape)

    def decode(
        self,
        index: int,
        quantization: Quantization,
        prediction: Prediction,
        priors: LearnedPriors,
        allowance: Allowance | None = None,
    ) -> FrameCoroutine:
        """Decode one frame."""
        planes = self._coder.decoder(self.layout.num_bits)
        state = FrameState(self.layout, prediction, self._config.wyner_ziv.noise_model)
        allowance = allowance or Allowance()
        return _Frame(self._config, self.layout, planes, priors, allowance, index).decode(quantization, state)


@dataclass(frozen=True)
class _Frame:
    """One frame while it is decoded."""

    config: CodecConfig
    layout: FrameLayout
    plane_decoder: slepian_wolf.PlaneDecoder
    priors: LearnedPriors
    allowance: Allowance
    index: int

    def decode(self, quantization: Quantization, state: FrameState) -> FrameCoroutine:
        decoded: dict[int, list[slepian_wolf.PlaneResult]] = {}
        check = slepian_wolf.FrameCheck()
        for bands in _between_refinements(quantization.bands):
            steps = [self._decode_band(band, quantization, state) for band in bands]
            found = yield from slepian_wolf.side_by_side(steps)
            for band, own in zip(bands, found, strict=True):
                decoded[band] = own.planes
                if own.planes:
                    state.gain = float(np.sqrt(state.gain * own.gain))
                    state.set_known(band, own.known)
            if bands[-1] == quantization.bands[-1]:
                (check,) = yield from slepian_wolf.side_by_side([self.plane_decoder.check(self.index)])
                self._correct(check, decoded, quantization, state)
            if any(own.planes for own in found):
                state.refine()
        results = [result for planes in decoded.values() for result in planes]
        return DecodedFrame(
            index=self.index,
            frame=state.frame(),
            side_information=state.side_information,
            refined_side_information=state.refined_side_information(),
            inverse_depth=state.inverse_depth,
            camera=state.camera,
            method=state.method,
            reason=state.reason,
            num_requests=check.num_requests + sum(result.num_requests for result in results),
            crc_bits=check.crc_bits + sum(result.crc_bits for result in results),
            parity_bits=sum(result.parity_bits for result in results),
            num_failed_planes=int(not check.success),
            num_skipped_planes=quantization.num_planes - len(results),
            band_costs=tuple(_cost(band, planes) for band, planes in decoded.items() if planes),
        )

    def _decode_band(self, band: int, quantization: Quantization, state: FrameState) -> BandCoroutine:
        edges = quantization.edges(band)
        planes, shape = quantization.planes[band], self.layout.band_shape
        refined = not state.known
        predicted, scale = state.predicted[band].ravel(), state.scale(band).ravel()
        prefix = np.zeros(self.layout.num_bits, dtype=np.int64)
        lower, upper = quantizer.prefix_borders(prefix, planes, edges)
        gain, results, multiplier, expected_bits = state.gain, [], quantization.multiplier, 0.0
        for plane in range(planes):
            missing = planes - plane - 1
            if multiplier > 0:
                depth = min(missing + 1, LOOK_AHEAD)
                worth = expected_refinement(prefix, missing + 1, edges, predicted, scale * gain, depth)
                if not _is_worth_its_rate(worth, self.plane_decoder.cost, multiplier):
                    break
                expected_bits = self.plane_decoder.cost.bits(float(worth.bits[0]))
            if not self.allowance.begin(expected_bits):
                break
            middle, _ = quantizer.prefix_borders(2 * prefix + 1, missing, edges)
            place, borders = (quantization.first_plane[band] + plane, band, plane), (lower, middle, upper)
            result = yield from self._decode_plane(place, borders, predicted, scale * gain, state)
            results.append(result)
            self.allowance.end(expected_bits, result.parity_bits + result.crc_bits)
            prefix = 2 * prefix + result.bits
            lower, upper = quantizer.prefix_borders(prefix, missing, edges)
            if plane < NUM_FITTED_PLANES or missing == 0:
                gain = noise.fit_gain(lower, upper, predicted, scale, gain if missing else state.gain)
            if refined and missing and np.mean(upper - lower) < REFINING_WIDTH * gain * np.mean(scale):
                state.refine_by_part(band, KnownBand.of(lower, upper, scale * gain, shape))
                predicted, scale = state.predicted[band].ravel(), state.scale(band).ravel()
                gain = noise.fit_gain(lower, upper, predicted, scale, gain)
        return DecodedBand(results, gain, KnownBand.of(lower, upper, scale * gain, shape))

    def _decode_plane(
        self,
        place: tuple[int, int, int],
        borders: tuple[Array, Array, Array],
        predicted: Array,
        scale: Array,
        state: FrameState,
    ) -> Generator[slepian_wolf.ParityRequest, Bits, slepian_wolf.PlaneResult]:
        """Decode a plane; `place` is its number in the frame, its band, and its number in that."""
        number = self.index, place[0]
        if self.config.wyner_ziv.priors == "laplacian":
            llr = noise.bit_llr(*borders, predicted, scale)
            return (yield from self.plane_decoder.decode(llr, number))
        prior = self.priors.plane(place[1:], borders, predicted, scale, state.dc_error())
        result = yield from self.plane_decoder.decode(prior.llr, number, prior.coupling)
        self.priors.learn(prior, result.bits)
        return result

    def _correct(
        self,
        check: slepian_wolf.FrameCheck,
        decoded: dict[int, list[slepian_wolf.PlaneResult]],
        quantization: Quantization,
        state: FrameState,
    ) -> None:
        """Put planes that the check of the frame has corrected in the place of those decoded before."""
        for band, results in decoded.items():
            first = quantization.first_plane[band]
            places = check.corrected.keys() & range(first, first + len(results))
            for place in places:
                results[place - first] = check.corrected[place]
            if places:
                prefix = quantizer.from_planes(np.stack([result.bits for result in results]))
                missing = quantization.planes[band] - len(results)
                state.correct(band, *quantizer.prefix_borders(prefix, missing, quantization.edges(band)))
