"""Turbo codes as a coder of planes: the punctured pair of the thesis, and a check of each plane by itself.

Iterations decode a bit plane from its side information and the parity received so far.
"""

import itertools
import math
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.checks import CRC_BITS, crc
from dvc.slepian_wolf.coupling import NeighbourCoupling, bounded_llr, entropy_bits, ideal_bits
from dvc.slepian_wolf.plane_protocol import FrameCheck, PlaneCoroutine, PlaneCost, PlaneResult, Words
from dvc.slepian_wolf.requests import Bits, Kind, ParityRequest, ask
from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.turbo_encoder import (
    FEEDBACK,
    FEEDFORWARD,
    PERIOD,
    interleaved,
    release_layout,
    release_order,
    section_starts,
    trellis,
)

Floats = NDArray[np.float32]
UNCODED_ENTROPY = 0.9
"""Entropy per bit above which a plane is requested uncoded."""
FIRST_CHECK_BITS = 8
"""Number of check bits of the first request, as in [Artigas2007]; more follow if needed."""
ERROR_EXPONENT = 15.0
"""A plane is accepted when the odds against it are below 2 to minus this."""
SURE_ERRORS = 2.0**-6
"""Number of expected errors up to which decisions are sure; with more, iterations continue first."""
POLISH_ITERATIONS = 4

# Sizes of requests and numbers of iterations: a trade of rate for time (`dvc-rd run` with `options.coder`).
FIRST_REQUEST = 0.9
"""First parity, as a share of the entropy."""
STEP, LATE_STEP, LATE = 0.02, 0.04, 1.6
"""Further parity as a share of the received parity or of the entropy; more from `LATE` of the entropy on,
because side information misleads then."""
MIN_STEP_BITS = 3
ITERATIONS, MAX_ITERATIONS, PROGRESS = 4, 30, 0.95
"""Iterations after a request, and again while they cut the expected errors to this share."""
STUCK_ERRORS, STUCK_STEP, STUCK_ITERATIONS = 0.98, 0.03, 2
"""Further parity of a plane that still has this share of its initially expected errors."""
MIN_WINDOW_STEPS = 24
"""Fewest trellis steps that make another window worth its unknown ends."""


@dataclass(frozen=True)
class LaneLayout:
    """How trellis sections are cut into windows that run in lock step, one per lane."""

    num_steps: int  # steps L of every lane; short lanes are padded with free steps
    cell_of_step: NDArray[np.int32]  # flat index into (L, W) arrays of each trellis step
    opens: NDArray[np.bool_]  # whether the lane starts a section, in state zero
    closes: NDArray[np.bool_]  # whether the lane ends a section, in an unknown state


def lane_layout(section_edges: tuple[int, ...], num_windows: int | None = None) -> LaneLayout:
    """Cut trellis sections into windows of equal length."""
    lengths = np.diff(section_edges)
    max_steps = int(lengths.max())
    if num_windows is None:
        num_windows = max(1, min(_kernels.NUM_LANES // lengths.size, max_steps // MIN_WINDOW_STEPS))
    num_steps = -(-max_steps // num_windows)
    cell_of_step = np.empty(section_edges[-1], np.int32)
    opens = np.ones(_kernels.NUM_LANES, np.bool_)
    closes = np.ones(_kernels.NUM_LANES, np.bool_)
    for section, (start, end) in enumerate(itertools.pairwise(section_edges)):
        k = np.arange(end - start)
        lane = section * num_windows
        cell_of_step[start:end] = (k % num_steps) * _kernels.NUM_LANES + lane + k // num_steps
        opens[lane + 1 : lane + num_windows] = False
        closes[lane : lane + num_windows - 1] = False
    return LaneLayout(num_steps, cell_of_step, opens, closes)


@lru_cache(maxsize=64)
def bcjr_recursions(feedback: int, feedforward: int) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the compiled forward and backward recursion of an RSC code."""
    table = trellis(feedback, feedforward)
    masks = (len(table.next_state), table.input_mask, table.parity_mask)
    return _kernels.make_forward(*masks), _kernels.make_backward(*masks)


class LaneDecoder:
    """BCJR over all windows of a trellis, with the metrics that windows hand to each other between passes."""

    def __init__(self, feedback: int, feedforward: int, lanes: LaneLayout) -> None:
        self.lanes = lanes
        self._forward, self._backward = bcjr_recursions(feedback, feedforward)
        num_states = len(trellis(feedback, feedforward).next_state)
        arrays = np.zeros((6, lanes.num_steps * _kernels.NUM_LANES), np.float32)
        self.llr_a, self.llr_e, *inputs = arrays
        self.prob0, self.prob1, self._allow0, self._allow1 = self._inputs = tuple(inputs)
        records = (lanes.num_steps + 1) * (_kernels.ROW_METRIC + num_states)
        self._work = np.zeros(records * _kernels.NUM_LANES, np.float32)
        self.edges = np.empty((2, num_states * _kernels.NUM_LANES), np.float32)
        self.reset()

    def reset(self) -> None:
        """Forget all messages and all parity."""
        self.llr_a.fill(0)
        self.llr_e.fill(0)
        self._allow0.fill(1)
        self._allow1.fill(1)
        self.edges.fill(1)
        self.edges.reshape(2, -1, _kernels.NUM_LANES)[0, 1:, self.lanes.opens] = 0

    def set_parity(self, steps: NDArray[np.int32], bits: NDArray[np.uint8]) -> None:
        """Restrict the trellis to the parity bits known at some steps."""
        cells = self.lanes.cell_of_step[steps]
        self._allow0[cells], self._allow1[cells] = bits == 0, bits == 1

    def run(self) -> None:
        """Pass once over the trellis: probabilities in, extrinsic LLRs and new edge metrics out."""
        self._forward(*self._inputs, self._work, self.edges)
        self._backward(*self._inputs, self._work, self.edges, self.llr_e)
        _kernels.finish_pass(self.edges, self.lanes.opens, self.lanes.closes, self.llr_e)


class TurboDecoder:
    """Decoder of one bit plane after another; keeps its messages while parity arrives."""

    def __init__(self, num_bits: int, seed: int) -> None:
        self.num_bits = num_bits
        self._bit_at_step = interleaved(num_bits, seed)
        self._starts = section_starts(num_bits)
        self._order = release_order(num_bits, PERIOD)
        self._trellis = trellis(FEEDBACK, FEEDFORWARD)
        lanes = lane_layout((*self._starts.tolist(), self._bit_at_step.size))
        self._siso = LaneDecoder(FEEDBACK, FEEDFORWARD, lanes)
        self._bit_of_cell = np.full(self._siso.llr_a.size, num_bits, np.uint32)  # cells that pad lanes: bit N
        self._bit_of_cell[lanes.cell_of_step] = self._bit_at_step
        self._parity = np.full(self._bit_at_step.size, -1, np.int8)
        self._llr_ch = np.zeros(num_bits + 1, np.float32)
        self._llr = np.zeros(num_bits + 1, np.float32)
        self.decisions: NDArray[np.uint8] = np.zeros(num_bits, np.uint8)
        self.num_parity = 0
        self.parity_satisfied = True

    @property
    def expected_errors(self) -> float:
        """Number of wrong decisions to be expected by the a posteriori LLRs."""
        return float(_kernels.sum_of_error_probabilities(self._llr[:-1]))

    def start(self, llr: Floats) -> None:
        """Begin a new plane, with LLRs of `bounded_llr`."""
        self._llr_ch[:-1] = llr
        self._siso.reset()
        self._exchange_messages()
        self._parity.fill(-1)
        self.num_parity = 0
        self.parity_satisfied = True

    def add_parity(self, bits: NDArray[np.uint8]) -> None:
        """Take the next parity bits in order of release; they are free of errors."""
        steps = self._order[self.num_parity : self.num_parity + bits.size]
        self._parity[steps] = bits
        self._siso.set_parity(steps, bits)
        self.num_parity += bits.size
        self._check_parity()

    def iterate(self, max_iterations: int, polish: bool = False) -> int:
        """Iterate until all received parity is satisfied, or to see how sure decisions become; count."""
        for done in range(1, max_iterations + 1):
            self._siso.run()
            self._exchange_messages()
            self._check_parity()
            if self.parity_satisfied and not polish:
                return done
        return max_iterations

    def _exchange_messages(self) -> None:
        siso = self._siso
        messages = siso.llr_e, siso.llr_a, siso.prob0, siso.prob1
        _kernels.exchange_messages(self._llr_ch, self._bit_of_cell, *messages, self._llr, self.decisions)

    def _check_parity(self) -> None:
        """Encode the decisions again."""
        steps, table = (self._bit_at_step, self._starts), self._trellis
        self.parity_satisfied = _kernels.satisfies(
            self.decisions, *steps, table.next_state, table.output, self._parity
        )


class _Plane:
    """State of one plane while it is decoded."""

    def __init__(self, position: tuple[int, int], llr: NDArray[np.float32]) -> None:
        self.position, self.llr, self.num_bits = position, llr, llr.size
        self.entropy_bits = entropy_bits(llr)
        self.num_requests = self.iterations = self.num_uncoded = 0
        self.stuck = False
        self.check, self.parity = np.zeros(0, np.uint8), np.zeros(0, np.uint8)

    def request(self, kind: Kind, start: int, count: int) -> Generator[ParityRequest, Bits, Bits]:
        self.num_requests += 1
        return (yield from ask(ParityRequest(*self.position, kind, 0, start, count)))

    def request_check(self, count: int) -> Generator[ParityRequest, Bits, None]:
        """Request check bits up to `count`."""
        new = yield from self.request("crc", self.check.size, count - self.check.size)
        self.check = np.concatenate([self.check, new])

    def request_parity(self) -> Generator[ParityRequest, Bits, Bits]:
        received, entropy = self.parity.size, self.entropy_bits
        if received == 0:
            count = max(1, int(FIRST_REQUEST * entropy))
        else:
            step = LATE_STEP if received > LATE * entropy else STUCK_STEP if self.stuck else STEP
            count = max(MIN_STEP_BITS, int(step * max(received, entropy)))
        new = yield from self.request("parity", received, min(count, self.num_bits - received))
        self.parity = np.concatenate([self.parity, new])
        return new

    def fetch(self) -> PlaneCoroutine:
        """Ask for the bits themselves."""
        bits = yield from self.request("uncoded", 0, self.num_bits)
        self.num_uncoded = self.num_bits
        return self.result(bits)

    def checks(self, bits: Bits) -> bool:
        return bool((crc(bits, CRC_BITS)[: self.check.size] == self.check).all())

    def accept(self, bits: Bits, expected_errors: float) -> Generator[ParityRequest, Bits, bool]:
        """Return whether a plane that satisfies all parity is right; request check bits if that is open."""
        if not self.checks(bits):
            return False
        # Quantised costs and whole exponents: the last digit of a library's logarithm must not decide.
        cost = math.ceil(ideal_bits(self.llr, bits) * 16) / 16
        likelier = cost if cost > 30 else math.log2(max(2.0**cost - 1, 2.0**-60))
        mantissa, exponent = math.frexp(max(expected_errors, 2.0**-60))
        near = exponent - (mantissa == 0.5)  # the logarithm, rounded up
        evidence = ERROR_EXPONENT + max(likelier - self.parity.size, near) - self.check.size
        missing = math.ceil(evidence)  # bits that must agree before the plane is accepted
        if missing <= 0:
            return True
        if self.check.size + missing > CRC_BITS:
            return False
        yield from self.request_check(self.check.size + missing)
        return self.checks(bits)

    def result(self, bits: Bits) -> PlaneResult:
        counts = self.num_requests, self.check.size, self.parity.size + self.num_uncoded, self.iterations
        return PlaneResult(bits.copy(), *counts, self.entropy_bits, ideal_bits(self.llr, bits))


def decode_plane(
    llr_ch: NDArray[np.floating], decoder: TurboDecoder, position: tuple[int, int] = (0, 0)
) -> PlaneCoroutine:
    """Decode one bit plane as a coroutine: it yields requests and is sent the bits."""
    plane = _Plane(position, bounded_llr(llr_ch))
    if plane.entropy_bits >= UNCODED_ENTROPY * plane.num_bits:
        return (yield from plane.fetch())
    yield from plane.request_check(FIRST_CHECK_BITS)
    decisions = (plane.llr < 0).astype(np.uint8)
    if (yield from plane.accept(decisions, 0.0)):
        return plane.result(decisions)
    decoder.start(plane.llr)
    first_errors = decoder.expected_errors
    while plane.parity.size < plane.num_bits:
        decoder.add_parity((yield from plane.request_parity()))
        # Iterate in blocks as long as that makes the decisions surer.
        block, progress = (STUCK_ITERATIONS, STUCK_ERRORS) if plane.stuck else (ITERATIONS, PROGRESS)
        before = decoder.expected_errors
        for start in range(0, MAX_ITERATIONS, block):
            plane.iterations += decoder.iterate(min(MAX_ITERATIONS - start, block))
            after = decoder.expected_errors
            if decoder.parity_satisfied or after > progress * before:
                break
            before = after
        plane.stuck = decoder.expected_errors > STUCK_ERRORS * first_errors
        if decoder.parity_satisfied:
            if decoder.expected_errors > SURE_ERRORS:
                plane.iterations += decoder.iterate(POLISH_ITERATIONS, polish=True)
            if (yield from plane.accept(decoder.decisions, decoder.expected_errors)):
                return plane.result(decoder.decisions)
    return (yield from plane.fetch())


class TurboPlaneDecoder:
    """Decodes planes of one length; idle decoders are kept for the next planes."""

    cost = PlaneCost(1.2, 10.0)

    def __init__(self, num_bits: int, seed: int) -> None:
        self._num_bits, self._seed = num_bits, seed
        self._idle: list[TurboDecoder] = []

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a plane as a coroutine; neighbours are left aside."""
        del coupling
        decoder = self._idle.pop() if self._idle else TurboDecoder(self._num_bits, self._seed)
        try:
            return (yield from decode_plane(llr_ch, decoder, position))
        finally:
            self._idle.append(decoder)

    def check(self, frame: int) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Do nothing."""
        yield from ()
        return FrameCheck()


class TurboCoder:
    """The classical punctured pair."""

    num_codes = 1
    by_positions = False

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._decoders: dict[int, TurboPlaneDecoder] = {}  # by length of the planes

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Compute the parity of up to 64 planes."""
        del code
        layout = release_layout(words.size, self._seed)
        _kernels.encode_words(words, *layout, FEEDBACK, FEEDFORWARD, parity)

    def decoder(self, num_bits: int) -> TurboPlaneDecoder:
        """Return a decoder of planes."""
        return self._decoders.setdefault(num_bits, TurboPlaneDecoder(num_bits, self._seed))
