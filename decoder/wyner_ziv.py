"""Decoding of one Wyner-Ziv frame as a coroutine without I/O: it yields requests and is sent bits.

Bands are decoded in zigzag order, each plane by plane, in the areas where a plane saves more than it costs:
the noise model turns side information and known planes into log-likelihood ratios, the Slepian-Wolf decoder
asks for parity until the bits are right, and the conditional mean reconstructs the coefficients. Decoded
planes teach the rest: scales are fitted to the decoded intervals, blocks that turned out worse than expected
are expected to be bad in later bands, and the side information is refined and fused with that of the start.
Bands between two refinements are decoded side by side: bits whose bins are equally wide are one run of the
coder, if it can.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoder.allowances import Allowance
from decoder.asking import Asking, Choice, Wanted
from decoder.band import Band, Part
from decoder.frame_state import FrameState
from decoder.learned import Learned
from decoder.side_information.protocol import Prediction
from decoder.tasks import BandCost, DecodedFrame
from dvc import slepian_wolf
from dvc.config import CodecConfig
from dvc.slepian_wolf.llr import bounded_llr, ideal_bits
from dvc.wynerziv import noise
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.priors import LearnedPriors, PlanePrior
from dvc.wynerziv.quantizer import FrameLayout, Quantization

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]

REFINE_AFTER = (0, 1, 2, 4, 8)
"""Positions of bands in coding order after which the side information is refined, beside the last one."""
REFINING_WIDTH = 4.0
"""Mean interval of the first band, in scales, below which each of its planes refines the side information."""


FrameCoroutine = Generator[slepian_wolf.Round, Sequence[Bits], DecodedFrame]
RunCoroutine = Generator[slepian_wolf.ParityRequest, Bits, slepian_wolf.PlaneResult]


def _between_refinements(bands: Sequence[int]) -> Iterator[Sequence[int]]:
    """Divide bands, in coding order, where the side information is refined."""
    ends = [0, *(position + 1 for position in REFINE_AFTER if position + 1 < len(bands)), len(bands)]
    return (bands[first:end] for first, end in pairwise(ends) if first < end)


class WynerZivDecoder:
    """Decodes Wyner-Ziv frames of one configuration, also several side by side."""

    def __init__(self, config: CodecConfig) -> None:
        self.layout = FrameLayout.of(config)
        self._config = config
        self._coder = slepian_wolf.plane_coder(config)
        self._areas = Areas(self.layout.band_shape)

    def nothing_learned(self) -> Learned:
        """Return what is known before anything is decoded."""
        return Learned(LearnedPriors(self.layout.band_shape))

    def predicted(self, index: int, prediction: Prediction) -> DecodedFrame:
        """Return a frame of which nothing was sent."""
        return _outcome(index, FrameState(self.layout, prediction, self._config.wyner_ziv.noise_model))

    def decode(
        self,
        index: int,
        quantization: Quantization,
        prediction: Prediction,
        learned: Learned,
        allowance: Allowance | None = None,
    ) -> FrameCoroutine:
        """Decode one frame."""
        planes = self._coder.decoder(self.layout.num_bits)
        state = FrameState(self.layout, prediction, self._config.wyner_ziv.noise_model)
        allowance = allowance or Allowance()
        asking = Asking(self._areas, learned.worth, planes.cost, quantization.multiplier)
        choose = asking.by_areas if self._coder.by_positions else asking.whole_planes
        is_learned = self._config.wyner_ziv.priors == "learned"
        return _Frame(index, state, planes, learned, is_learned, choose, allowance).decode(quantization)


def _outcome(index: int, state: FrameState, **costs: Any) -> DecodedFrame:
    """Return a frame as far as it is decoded, and what it cost."""
    return DecodedFrame(
        index=index,
        frame=state.frame(),
        side_information=state.side_information,
        refined_side_information=state.refined_side_information(),
        inverse_depth=state.inverse_depth,
        camera=state.camera,
        method=state.method,
        reason=state.reason,
        **costs,
    )


@dataclass
class _Frame:
    """One frame while it is decoded."""

    index: int
    state: FrameState
    plane_decoder: slepian_wolf.PlaneDecoder
    learned: Learned
    has_learned_priors: bool
    choose: Callable[[Sequence[Band], int], list[Choice]]
    allowance: Allowance
    bands: dict[int, Band] = field(default_factory=dict)
    runs: dict[int, slepian_wolf.PlaneResult] = field(default_factory=dict)  # by their first planes
    costs: dict[int, list[float]] = field(default_factory=dict)  # of bands: ideal bits, bits

    def decode(self, quantization: Quantization) -> FrameCoroutine:
        state, check = self.state, slepian_wolf.FrameCheck()
        for numbers in _between_refinements(quantization.bands):
            bands = [Band.start(number, quantization, state) for number in numbers]
            self.bands |= dict(zip(numbers, bands, strict=True))
            yield from self._decode_stage(bands)
            asked = [band for band in bands if band.parts]
            for band in asked:
                state.gain = float(np.sqrt(state.gain * band.gain))
                state.set_known(band.number, band.known)
            if numbers[-1] == quantization.bands[-1]:
                (check,) = yield from slepian_wolf.side_by_side([self.plane_decoder.check(self.index)])
                self._correct(check)
            if asked:
                state.refine()
        results = self.runs.values()
        return _outcome(
            self.index,
            state,
            num_requests=check.num_requests + sum(result.num_requests for result in results),
            crc_bits=check.crc_bits + sum(result.crc_bits for result in results),
            parity_bits=sum(result.parity_bits for result in results),
            num_failed_planes=int(not check.success),
            num_skipped_planes=quantization.num_planes - sum(len(b.parts) for b in self.bands.values()),
            band_costs=tuple(
                BandCost(band, ideal, round(bits)) for band, (ideal, bits) in sorted(self.costs.items())
            ),
        )

    def _decode_stage(self, bands: Sequence[Band]) -> Generator[slepian_wolf.Round, Sequence[Bits], None]:
        """Decode bands side by side, from their widest bins to the finest, each as far as that pays."""
        refines = not self.state.known and len(bands) == 1
        for missing in reversed(range(max(band.num_planes for band in bands))):
            ready = [band for band in bands if band.num_planes > missing and band.open.size]
            found = self.choose(ready, missing) if ready else []
            choices = [choice for choice in found if self.allowance.begin(choice.bits)]
            going_on = {wanted.band.number for choice in choices for wanted in choice.wanted}
            for band in ready:
                if band.number not in going_on:
                    band.open = band.open[:0]
            yield from slepian_wolf.side_by_side([self._decode_run(choice, missing) for choice in choices])
            if refines and missing and going_on:
                (band,) = bands
                if np.mean(band.upper - band.lower) < REFINING_WIDTH * band.gain * np.mean(band.scale):
                    self.state.refine_by_part(band.number, band.known)
                    band.predict(self.state)

    def _decode_run(self, choice: Choice, missing: int) -> RunCoroutine:
        """Decode the next plane of some bands, in the blocks where it is wanted."""
        priors = [self._prior(wanted, missing) for wanted in choice.wanted]
        couplings = [prior.coupling for prior in priors if isinstance(prior, PlanePrior)]
        coupling = slepian_wolf.NeighbourCoupling.stacked(couplings) if couplings else None
        number = choice.run.planes[0]
        llr = np.concatenate([prior.llr if isinstance(prior, PlanePrior) else prior for prior in priors])
        steps = self.plane_decoder.decode(llr, (self.index, number), coupling)
        result = yield from slepian_wolf.beginning(choice.run, steps)
        num_bits = result.parity_bits + result.crc_bits
        self.allowance.end(choice.bits, num_bits)
        self.runs[number] = result
        first, found = 0, []
        for wanted, prior in zip(choice.wanted, priors, strict=True):
            part = Part(wanted.blocks, number, first)
            found.append(self._take(wanted.band, part, prior, missing))
            first += wanted.blocks.size
        whole = sum(ideal for ideal, _ in found)
        for wanted, (ideal, saved) in zip(choice.wanted, found, strict=True):
            paid = num_bits * (ideal / whole if whole > 0.0 else 1.0 / len(found))
            cost = self.costs.setdefault(wanted.band.number, [0.0, 0.0])
            cost[:] = cost[0] + ideal, cost[1] + paid
            self.learned.worth.learn(wanted.band.number, missing, wanted.expected, (saved, paid))
        return result

    def _prior(self, wanted: Wanted, missing: int) -> PlanePrior | Array:
        """Return what is known of bits before they are decoded; LLRs alone where nothing is learned."""
        band, borders = wanted.band, wanted.band.borders(missing)
        if not self.has_learned_priors:
            return noise.bit_llr(*borders, band.predicted, band.noise)[wanted.blocks]
        dc_error = self.state.dc_error()
        return self.learned.priors.plane(
            band.place(missing), borders, band.predicted, band.noise, dc_error, wanted.blocks
        )

    def _take(self, band: Band, part: Part, prior: PlanePrior | Array, missing: int) -> tuple[float, float]:
        """Take in bits of a band; return their ideal code length, and the squared error they take off."""
        bits = part.of(self.runs[part.run].bits)
        if isinstance(prior, PlanePrior):
            self.learned.priors.learn(prior, bits)
        llr = prior.coupling.llr_in_sequence(bits) if isinstance(prior, PlanePrior) else prior
        return ideal_bits(bounded_llr(llr), bits), band.take(part, bits, missing)

    def _correct(self, check: slepian_wolf.FrameCheck) -> None:
        """Put runs that the check of the frame has corrected in the place of those decoded before."""
        self.runs |= check.corrected
        for number, band in self.bands.items():
            if any(part.run in check.corrected for part in band.parts):
                band.enter_again({part.run: self.runs[part.run].bits for part in band.parts})
                self.state.correct(number, band.lower, band.upper)
