"""Iterative decoding of one bit plane from its side information and the parity received so far."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.codes import TurboCode
from dvc.slepian_wolf.turbo.interleaver import interleaved, section_starts
from dvc.slepian_wolf.turbo.puncturing import release_order
from dvc.slepian_wolf.turbo.siso import LaneDecoder, lane_layout
from dvc.slepian_wolf.turbo.trellis import trellis

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
