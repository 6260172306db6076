"""Iterative decoding of one bit plane from its side information and the parity received so far."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.slepian_wolf._kernels import bit_probabilities
from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.turbo_encoder import (
    TurboCode,
    interleaved,
    release_order,
    section_starts,
    trellis,
)

Floats = NDArray[np.float32]
Recursion = Callable[..., None]
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
    if num_windows < 1 or num_windows * lengths.size > _kernels.NUM_LANES:
        raise ValueError(
            f"{lengths.size} sections of {num_windows} windows do not fit {_kernels.NUM_LANES} lanes"
        )
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
def bcjr_recursions(feedback: int, feedforward: int) -> tuple[Recursion, Recursion]:
    """Return the compiled forward and backward recursion of an RSC code."""
    table = trellis(feedback, feedforward)
    masks = (table.num_states, table.input_mask, table.parity_mask)
    return _kernels.make_forward(*masks), _kernels.make_backward(*masks)


class LaneDecoder:
    """BCJR over all windows of a trellis, with the metrics that windows hand to each other between passes."""

    def __init__(self, feedback: int, feedforward: int, lanes: LaneLayout) -> None:
        self.lanes = lanes
        self._forward, self._backward = bcjr_recursions(feedback, feedforward)
        num_states = trellis(feedback, feedforward).num_states
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
        _kernels.set_parity(self.lanes.cell_of_step[steps], bits, self._allow0, self._allow1)

    def run(self) -> None:
        """Pass once over the trellis: probabilities in, extrinsic LLRs and new edge metrics out."""
        self._forward(*self._inputs, self._work, self.edges)
        self._backward(*self._inputs, self._work, self.edges, self.llr_e)
        _kernels.finish_pass(self.edges, self.lanes.opens, self.lanes.closes, self.llr_e)


def siso(
    llr_a: ArrayLike, parity: NDArray[np.int8], feedback: int, feedforward: int, num_windows: int = 1
) -> Floats:
    """Compute the extrinsic LLRs of the input bits of one trellis that starts in state zero."""
    llr = np.asarray(llr_a, np.float32)
    if llr.ndim != 1 or llr.size < 1 or np.isnan(llr).any():
        raise ValueError(f"`llr_a` must be a vector of numbers, got shape {llr.shape}")
    if parity.shape != llr.shape or not np.isin(parity, (-1, 0, 1)).all():
        raise ValueError(f"`parity` must hold -1, 0 or 1 in shape {llr.shape}, got shape {parity.shape}")
    lanes = lane_layout((0, llr.size), num_windows)
    decoder = LaneDecoder(feedback, feedforward, lanes)
    steps = np.flatnonzero(parity >= 0).astype(np.int32)
    decoder.set_parity(steps, parity[steps].astype(np.uint8))
    decoder.llr_a[lanes.cell_of_step] = np.clip(llr, -_kernels.MAX_EXTRINSIC, _kernels.MAX_EXTRINSIC)
    bit_probabilities(decoder.llr_a, decoder.prob0, decoder.prob1)
    decoder.run()
    return decoder.llr_e[lanes.cell_of_step]


MAX_CHANNEL_LLR = 24.0
"""Side information is never taken for surer than this, which keeps float32 exact enough."""


class TurboDecoder:
    """Decoder of one bit plane after another with one code; keeps its messages while parity arrives."""

    def __init__(self, code: TurboCode, num_bits: int, seed: int) -> None:
        self.num_bits = num_bits
        self._bit_at_step = interleaved(num_bits, seed)
        self._starts = section_starts(num_bits)
        self._order = release_order(num_bits, code.period)
        self._trellis = trellis(code.feedback, code.feedforward)
        lanes = lane_layout((*self._starts.tolist(), self._bit_at_step.size))
        self._siso = LaneDecoder(code.feedback, code.feedforward, lanes)
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

    def start(self, llr_ch: ArrayLike) -> None:
        """Begin a new plane."""
        llr = np.asarray(llr_ch, np.float32)
        if llr.shape != (self.num_bits,) or np.isnan(llr).any():
            raise ValueError(f"`llr_ch` must be {self.num_bits} numbers, got shape {llr.shape}")
        self._llr_ch[:-1] = np.clip(llr, -MAX_CHANNEL_LLR, MAX_CHANNEL_LLR)
        self._siso.reset()
        self._exchange_messages()
        self._parity.fill(-1)
        self.num_parity = 0
        self.parity_satisfied = True

    def add_parity(self, bits: NDArray[np.uint8]) -> None:
        """Take the next parity bits in order of release; they are free of errors."""
        bits = np.asarray(bits)
        end = self.num_parity + bits.size
        if bits.ndim != 1 or end > self._order.size or (bits.size and (bits.min() < 0 or bits.max() > 1)):
            left = self._order.size - self.num_parity
            raise ValueError(f"`bits` must be at most {left} parity bits of 0 and 1, got shape {bits.shape}")
        steps = self._order[self.num_parity : end]
        self._parity[steps] = bits
        self._siso.set_parity(steps, bits)
        self.num_parity = end
        self._check_parity()

    def iterate(self, max_iterations: int) -> int:
        """Go on decoding until all received parity is satisfied or the iterations are used up."""
        for done in range(1, max_iterations + 1):
            self._pass()
            if self.parity_satisfied:
                return done
        return max_iterations

    def polish(self, num_iterations: int) -> int:
        """Go on decoding, even where all parity is satisfied, to see how sure the decisions become."""
        for _ in range(num_iterations):
            self._pass()
        return num_iterations

    def _exchange_messages(self) -> None:
        siso = self._siso
        _kernels.exchange_messages(
            self._llr_ch,
            self._bit_of_cell,
            siso.llr_e,
            siso.llr_a,
            siso.prob0,
            siso.prob1,
            self._llr,
            self.decisions,
        )

    def _pass(self) -> None:
        """Pass over the trellis, exchange messages at the bits, decide, and encode the decisions again."""
        self._siso.run()
        self._exchange_messages()
        self._check_parity()

    def _check_parity(self) -> None:
        table = self._trellis
        self.parity_satisfied = _kernels.satisfies(
            self.decisions,
            self._bit_at_step,
            self._starts,
            table.next_state,
            table.output,
            self._parity,
        )
