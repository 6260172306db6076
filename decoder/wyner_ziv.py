"""Decoding of Wyner-Ziv frames as coroutines without I/O: a frame yields wishes and receives bits.

Bands are decoded in zigzag order, each plane by plane, in the areas where a plane saves more than it costs.
Later planes learn from decoded ones: scales are fitted to the decoded intervals, and the side information is
refined and fused with the initial one. Bands between two refinements are decoded in parallel: bits of bins of
equal width are requested together, if the coder can. Frames of a level are decoded in step: their next bits
are one run. Its cost is divided by the ideal code lengths of the bits.
"""

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from decoder.frame_state import Asking, Band, Choice, FrameState, Learned, Wanted
from decoder.group_tasks import BandCost, Bits, DecodedFrame
from decoder.side_information.protocol import Prediction
from dvc import slepian_wolf
from dvc.arrays import Floats, Integers
from dvc.config import CodecConfig
from dvc.slepian_wolf import CRC_BITS, MAX_RUN_BITS, NeighbourCoupling, Part, PlaneDecoder, PlaneResult, Round
from dvc.slepian_wolf.coupling import bounded_llr, ideal_bits
from dvc.wynerziv import noise
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.priors import LearnedPriors, PlanePrior
from dvc.wynerziv.quantizer import FrameLayout, Quantization

REFINE_AFTER = (0, 1, 2, 4, 8)
"""Positions in coding order of the bands after which the side information is refined, besides the last."""
REFINING_WIDTH = 4.0
"""Mean interval of the first band, in scales, below which each of its planes refines the side information."""

Prior = NeighbourCoupling | Floats
"""Prior of the bits of a plane: a coupling of neighbours, or LLRs."""


class Wish(NamedTuple):
    """Bits that a frame needs next, of some planes in some of its areas."""

    planes: tuple[int, ...]
    areas: bytes
    llr: Floats  # LLRs of all bits, one plane after the other
    priors: Sequence[Prior]  # prior of each plane


class Decoded(NamedTuple):
    """The bits of a plane that a frame wished for."""

    bits: Bits
    ideal_bits: float  # their ideal code length
    paid_bits: float  # their share of the received bits


class Allowance:
    """Bits that one frame may request, except those of its check; planes that were started are finished."""

    def __init__(self, bits: float = float("inf")) -> None:
        self.bits, self._left = bits, bits - 2.0 * CRC_BITS

    def begin(self, expected_bits: float) -> bool:
        """Reserve the expected cost of a plane if enough bits remain."""
        has_room = expected_bits <= self._left
        if has_room:
            self._left -= expected_bits
        return has_room

    def end(self, expected_bits: float, num_bits: float) -> None:
        """Replace the expected cost of a plane by the real one."""
        self._left += expected_bits - num_bits


FrameCoroutine = Generator[Sequence[Wish], Sequence[Sequence[Decoded]], DecodedFrame]
"""Yields wishes and is sent what came of each; at last none, and is sent all again if some were wrong."""
StageCoroutine = Generator[Sequence[Wish], Sequence[Sequence[Decoded]], None]


class WynerZivDecoder:
    """Decodes Wyner-Ziv frames of one configuration, also several side by side."""

    def __init__(self, config: CodecConfig) -> None:
        self.layout = FrameLayout.of(config)
        self._config = config
        self.coder = slepian_wolf.plane_coder(config)
        self._cost = self.coder.decoder(self.layout.num_bits).cost
        self._areas = Areas(self.layout.band_shape)

    def nothing_learned(self) -> Learned:
        """Return the initial state of learning."""
        return Learned(LearnedPriors(self.layout.band_shape))

    def predicted(self, index: int, prediction: Prediction) -> DecodedFrame:
        """Return a frame that consists of its prediction."""
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
        state = FrameState(self.layout, prediction, self._config.wyner_ziv.noise_model)
        allowance = allowance or Allowance()
        asking = Asking(self._areas, learned, self._cost, quantization.multiplier)
        choose = asking.by_areas if self.coder.by_positions else asking.whole_planes
        is_learned = self._config.wyner_ziv.priors == "learned"
        return _Frame(index, state, learned, is_learned, choose, allowance).decode(quantization)


def _outcome(index: int, state: FrameState, **costs: Any) -> DecodedFrame:
    """Return a frame in its current state, and its cost."""
    return DecodedFrame(
        index=index,
        frame=state.frame(),
        side_information=state.side_information,
        refined_side_information=state.luma(state.predicted),
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
    learned: Learned
    has_learned_priors: bool
    choose: Callable[[Sequence[Band], int], list[Choice]]
    allowance: Allowance
    bands: dict[int, Band] = field(default_factory=dict)
    taken: list[tuple[Band, Integers]] = field(default_factory=list)  # received planes, in order
    costs: dict[int, list[float]] = field(default_factory=dict)  # ideal and received bits of bands

    def decode(self, quantization: Quantization) -> FrameCoroutine:
        state = self.state
        coded = quantization.bands
        if not coded:
            yield ()
        ends = [0, *(position + 1 for position in REFINE_AFTER if position + 1 < len(coded)), len(coded)]
        for numbers in (coded[first:end] for first, end in pairwise(ends) if first < end):
            bands = [Band.start(number, quantization, state) for number in numbers]
            self.bands |= dict(zip(numbers, bands, strict=True))
            yield from self._decode_stage(bands)
            asked = [band for band in bands if band.num_taken]
            for band in asked:
                state.gain = float(np.sqrt(state.gain * band.gain))
                state.set_known(band.number, band.known)
            if numbers[-1] == coded[-1]:
                again = yield ()
                if again:  # some bits were wrong: all are entered again
                    for band in self.bands.values():
                        band.forget()
                    everything = [plane for planes in again for plane in planes]
                    for (band, blocks), (bits, _, _) in zip(self.taken, everything, strict=True):
                        band.enter(blocks, bits)
                    for number, known in state.known.items():
                        state.set_known(number, replace(self.bands[number].known, scale=known.scale))
            if asked:
                state.refine()
        return _outcome(
            self.index,
            state,
            num_skipped_planes=quantization.num_planes - sum(b.num_taken for b in self.bands.values()),
            band_costs=tuple(
                BandCost(band, ideal, round(bits)) for band, (ideal, bits) in sorted(self.costs.items())
            ),
        )

    def _decode_stage(self, bands: Sequence[Band]) -> StageCoroutine:
        """Decode bands in parallel, from their widest bins to the finest, each as deep as it pays."""
        refines = not self.state.known and len(bands) == 1
        for missing in reversed(range(max(band.num_planes for band in bands))):
            ready = [band for band in bands if band.num_planes > missing and band.open.size]
            found = self.choose(ready, missing) if ready else []
            choices = [choice for choice in found if self.allowance.begin(choice.bits)]
            continued = {wanted.band.number for choice in choices for wanted in choice.wanted}
            for band in ready:
                if band.number not in continued:
                    band.open = band.open[:0]
            if choices:
                yield from self._decode_planes(choices, missing)
            if refines and missing and continued:
                (band,) = bands
                if np.mean(band.upper - band.lower) < REFINING_WIDTH * band.gain * np.mean(band.scale):
                    self.state.set_known(band.number, band.known)  # without its missing planes
                    self.state.refine()
                    del self.state.known[band.number]
                    band.predict(self.state)

    def _decode_planes(self, choices: Sequence[Choice], missing: int) -> StageCoroutine:
        """Decode the next planes of some bands, in the requested blocks."""
        priors = [[self._prior(wanted, missing) for wanted in choice.wanted] for choice in choices]
        wishes = []
        for choice, of_planes in zip(choices, priors, strict=True):
            llr = [prior.llr if isinstance(prior, PlanePrior) else prior for prior in of_planes]
            coupled = [prior.coupling if isinstance(prior, PlanePrior) else prior for prior in of_planes]
            wishes.append(Wish(choice.planes, choice.areas, np.concatenate(llr), coupled))
        decoded = yield wishes
        for choice, of_planes, planes in zip(choices, priors, decoded, strict=True):
            self.allowance.end(choice.bits, sum(plane.paid_bits for plane in planes))
            for wanted, prior, (bits, ideal, paid) in zip(choice.wanted, of_planes, planes, strict=True):
                if isinstance(prior, PlanePrior):
                    self.learned.priors.learn(prior, bits)
                saved = wanted.band.take(wanted.blocks, bits, missing)
                self.taken.append((wanted.band, wanted.blocks))
                cost = self.costs.setdefault(wanted.band.number, [0.0, 0.0])
                cost[:] = cost[0] + ideal, cost[1] + paid
                self.learned.learn(wanted.band.number, missing, wanted.expected, (saved, paid))

    def _prior(self, wanted: Wanted, missing: int) -> PlanePrior | Floats:
        """Return the prior of bits; plain LLRs without learned priors."""
        band, borders = wanted.band, wanted.band.borders(missing)
        if not self.has_learned_priors:
            return noise.bit_llr(*borders, band.predicted, band.noise)[wanted.blocks]
        dc_error = self.state.dc_error()
        return self.learned.priors.plane(
            band.place(missing), borders, band.predicted, band.noise, dc_error, wanted.blocks
        )


class _Run:
    """Bits of a run, and the frames that they belong to."""

    def __init__(self, wishes: Sequence[tuple[int, Wish]], first_frame: int, number: int) -> None:
        self.wishes, self._position = wishes, (first_frame, number)
        self.result: PlaneResult | None = None
        self.decoded: list[list[Decoded]] = []  # results of each wish

    def decode(self, decoder: PlaneDecoder) -> Generator[slepian_wolf.ParityRequest, Bits, None]:
        """Decode its bits."""
        first, wishes = self._position[0], [wish for _, wish in self.wishes]
        priors = [prior for wish in wishes for prior in wish.priors]
        couplings = [prior for prior in priors if isinstance(prior, NeighbourCoupling)]
        coupling = NeighbourCoupling.stacked(couplings) if couplings else None
        parts = tuple(Part(index - first, wish.planes, wish.areas) for index, wish in self.wishes)
        llr = np.concatenate([wish.llr for wish in wishes])
        steps = decoder.decode(llr, self._position, coupling)
        self.take((yield from slepian_wolf.beginning(parts, steps)))

    def take(self, result: PlaneResult) -> None:
        """Divide the result among the wishes."""
        self.result = result
        paid_bits, start, by_wish = result.parity_bits + result.crc_bits, 0, []
        for _, wish in self.wishes:
            planes = []
            for prior in wish.priors:
                size = prior.places.size if isinstance(prior, NeighbourCoupling) else prior.size
                bits = result.bits[start : start + size]
                llr = prior.llr_given(bits, causal=True) if isinstance(prior, NeighbourCoupling) else prior
                planes.append((bits, ideal_bits(bounded_llr(llr), bits)))
                start += size
            by_wish.append(planes)
        whole = sum(ideal for planes in by_wish for _, ideal in planes)
        equal = 1.0 / sum(map(len, by_wish))
        self.decoded = [
            [
                Decoded(bits, ideal, paid_bits * (ideal / whole if whole > 0.0 else equal))
                for bits, ideal in planes
            ]
            for planes in by_wish
        ]


def decode_level(
    frames: Mapping[int, FrameCoroutine], decoder: PlaneDecoder, joins: bool
) -> Generator[Round, Sequence[Bits], list[DecodedFrame]]:
    """Decode frames in step; the first one names all runs; `joins`: whether wishes share runs."""
    started, runs = time.perf_counter(), list[_Run]()
    first = min(frames)
    wishes = {index: next(frame) for index, frame in frames.items()}
    while any(wishes.values()):
        asked = [(index, wish) for index, frame_wishes in wishes.items() for wish in frame_wishes]
        parts: list[list[tuple[int, Wish]]] = []  # wishes of each run, one frame after the other
        for index, wish in asked:
            fits = joins and parts and parts[-1][-1][0] < index
            if fits and sum(other.llr.size for _, other in parts[-1]) + wish.llr.size <= MAX_RUN_BITS:
                parts[-1].append((index, wish))
            else:
                parts.append([(index, wish)])
        begun = [_Run(part, first, len(runs) + number) for number, part in enumerate(parts)]
        runs += begun
        yield from slepian_wolf.side_by_side([run.decode(decoder) for run in begun])
        decoded = _by_frames(begun)
        for index in decoded:
            wishes[index] = frames[index].send(decoded[index])
    (check,) = yield from slepian_wolf.side_by_side([decoder.check(first)])
    for number, result in check.corrected.items():
        runs[number].take(result)
    again = _by_frames(runs) if check.corrected else {}
    results: list[DecodedFrame] = []
    for index, frame in frames.items():
        try:
            frame.send(again.get(index, ()))
        except StopIteration as stop:
            results.append(stop.value)
    decode_s = (time.perf_counter() - started) / len(frames)
    num_failed, costs = int(not check.success), _costs(runs, check, [*frames]).tolist()
    return [
        replace(
            frame,
            num_requests=num_requests,
            crc_bits=crc_bits,
            parity_bits=parity_bits,
            num_failed_planes=num_failed,
            decode_s=decode_s,
        )
        for frame, (num_requests, crc_bits, parity_bits) in zip(results, costs, strict=True)
    ]


def _by_frames(runs: Sequence[_Run]) -> dict[int, list[list[Decoded]]]:
    """Return the decoded bits of each frame."""
    by_frames: dict[int, list[list[Decoded]]] = {}
    for run in runs:
        for (index, _), decoded in zip(run.wishes, run.decoded, strict=True):
            by_frames.setdefault(index, []).append(decoded)
    return by_frames


def _costs(runs: Sequence[_Run], check: slepian_wolf.FrameCheck, frames: Sequence[int]) -> Integers:
    """Return requests, check bits and parity of each frame, in whole numbers that add up to all."""
    shared = [([check.num_requests, check.crc_bits, 0], dict.fromkeys(frames, 1.0))]
    for run in runs:
        assert run.result is not None
        paid = dict.fromkeys(frames, 0.0)
        for (index, _), decoded in zip(run.wishes, run.decoded, strict=True):
            paid[index] += sum(plane.paid_bits for plane in decoded)
        shared.append(([run.result.num_requests, run.result.crc_bits, run.result.parity_bits], paid))
    costs = np.zeros((len(frames), 3), np.int64)
    for totals, weights in shared:
        ends = np.cumsum([*weights.values()])
        ends = ends / ends[-1] if ends[-1] > 0.0 else np.arange(1, ends.size + 1) / ends.size
        rounded = np.rint(np.outer(ends, totals)).astype(np.int64)
        costs += rounded
        costs[1:] -= rounded[:-1]
    return costs
