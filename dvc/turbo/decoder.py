"""Iterative decoding of one bit plane from its side information and the parity received so far."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.turbo.codes import TurboCode
from dvc.turbo.interleaver import copy_layout
from dvc.turbo.puncturing import release_order
from dvc.turbo.trellis import Trellis, trellis

MIN_LANE_STEPS = 24
"""Fewest trellis steps that make another window worth its unknown ends."""
MAX_CHANNEL_LLR = 24.0
"""Side information is never taken for surer than this, which keeps float32 exact enough."""


@dataclass(frozen=True)
class LaneLayout:
    """How trellis sections are cut into windows that run in lock step, one per lane.

    Attributes
    ----------
    num_steps : int
        Steps L of every lane; short lanes are padded with free steps.
    cell_of_step : ndarray of shape (T,), int32
        Flat index into (L, W) arrays of each trellis step.
    opens : ndarray of shape (W,), bool
        Whether the lane starts a section, in state zero.
    closes : ndarray of shape (W,), bool
        Whether the lane ends a section, in an unknown state.
    first_copy, step_of_copy : ndarray, int32
        The cells of bit n are ``step_of_copy[first_copy[n]:first_copy[n + 1]]``.
    """

    num_steps: int
    cell_of_step: NDArray[np.int32]
    opens: NDArray[np.bool_]
    closes: NDArray[np.bool_]
    first_copy: NDArray[np.int32]
    step_of_copy: NDArray[np.int32]


@lru_cache(maxsize=64)
def lane_layout(code: TurboCode, num_bits: int, seed: int) -> LaneLayout:
    """Cut the trellis of a code into lanes.

    Parameters
    ----------
    code : TurboCode
        The code.
    num_bits, seed : int
        Length of the plane and interleaver seed.

    Returns
    -------
    LaneLayout
        Read-only.
    """
    from dvc.turbo._kernels import NUM_LANES

    layout = copy_layout(code, num_bits, seed)
    edges = [*layout.section_starts, layout.num_steps]
    lengths = np.diff(edges)
    lanes_each = max(1, min(NUM_LANES // lengths.size, int(lengths.max()) // MIN_LANE_STEPS))
    num_steps = -(-int(lengths.max()) // lanes_each)
    cell_of_step = np.empty(layout.num_steps, np.int32)
    opens = np.ones(NUM_LANES, np.bool_)
    closes = np.ones(NUM_LANES, np.bool_)
    for section, (start, end) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        k = np.arange(end - start)
        lane = section * lanes_each
        cell_of_step[start:end] = (k % num_steps) * NUM_LANES + lane + k // num_steps
        opens[lane + 1 : lane + lanes_each] = False
        closes[lane : lane + lanes_each - 1] = False
    by_bit = np.argsort(layout.bit_at_step, kind="stable")
    first_copy = np.concatenate([[0], np.cumsum(np.bincount(layout.bit_at_step, minlength=num_bits))])
    return LaneLayout(
        num_steps, cell_of_step, opens, closes, first_copy.astype(np.int32), cell_of_step[by_bit]
    )


class TurboDecoder:
    """Decoder of one bit plane after another with one code; keeps its messages while parity arrives.

    Parameters
    ----------
    code : TurboCode
        The code.
    num_bits : int
        Length N of the planes.
    interleaver_seed : int
        Seed that encoder and decoder share.
    """

    def __init__(self, code: TurboCode, num_bits: int, interleaver_seed: int) -> None:
        from dvc.turbo._kernels import NUM_LANES

        self.code = code
        self.num_bits = num_bits
        self.interleaver_seed = interleaver_seed
        self._layout = copy_layout(code, num_bits, interleaver_seed)
        self._starts = np.array(self._layout.section_starts, np.int64)
        self._order = release_order(code, num_bits)
        self._lanes = lane_layout(code, num_bits, interleaver_seed)
        self._trellis: Trellis = trellis(code.feedback, code.feedforward)
        num_states = self._trellis.num_states
        shape = (self._lanes.num_steps, NUM_LANES)
        self._llr_a, self._llr_e, self._prob0, self._prob1, self._sum0, self._sum1 = (
            np.zeros(shape, np.float32) for _ in range(6)
        )
        self._allow0, self._allow1 = np.ones(shape, np.float32), np.ones(shape, np.float32)
        self._alpha = np.empty((shape[0] + 1, num_states, NUM_LANES), np.float32)
        self._alpha_edge = np.empty((num_states, NUM_LANES), np.float32)
        self._beta_edge = np.empty((num_states, NUM_LANES), np.float32)
        self._parity = np.full(self._layout.num_steps, -1, np.int8)
        self._llr_ch = np.zeros(num_bits, np.float32)
        self.llr: NDArray[np.float32] = np.zeros(num_bits, np.float32)
        self.decisions: NDArray[np.uint8] = np.zeros(num_bits, np.uint8)
        self.num_parity = 0
        self.parity_satisfied = True

    def start(self, llr_ch: ArrayLike) -> None:
        """Begin a new plane.

        Parameters
        ----------
        llr_ch : array_like of shape (N,), float
            Side information as LLR log p(0) / p(1) of every bit.

        Raises
        ------
        ValueError
            If the shape is wrong or a value is not a number.
        """
        llr = np.asarray(llr_ch, np.float32)
        if llr.shape != (self.num_bits,) or np.isnan(llr).any():
            raise ValueError(f"`llr_ch` must be {self.num_bits} numbers, got shape {llr.shape}")
        self._llr_ch = np.clip(llr, -MAX_CHANNEL_LLR, MAX_CHANNEL_LLR)
        self._llr_e.fill(0)
        self._llr_a.fill(0)
        self._allow0.fill(1)
        self._allow1.fill(1)
        self._parity.fill(-1)
        self._alpha_edge.fill(1 / self._trellis.num_states)
        self._alpha_edge[:, self._lanes.opens] = 0
        self._alpha_edge[0, self._lanes.opens] = 1
        self._beta_edge.fill(1 / self._trellis.num_states)
        self.llr = self._llr_ch.copy()
        self.decisions = (self.llr < 0).astype(np.uint8)
        self.num_parity = 0
        self.parity_satisfied = True

    def add_parity(self, bits: NDArray[np.uint8]) -> None:
        """Take the next parity bits in order of release; they are free of errors.

        Parameters
        ----------
        bits : ndarray of shape (n,), uint8
            Each element 0 or 1.

        Raises
        ------
        ValueError
            If there are more bits than can be released, or a value other than 0 and 1.
        """
        bits = np.asarray(bits)
        end = self.num_parity + bits.size
        if bits.ndim != 1 or end > self._order.size or (bits.size and not np.isin(bits, (0, 1)).all()):
            raise ValueError(
                f"expected at most {self._order.size - self.num_parity} parity bits, got {bits.shape}"
            )
        steps = self._order[self.num_parity : end]
        self._parity[steps] = bits
        cells = self._lanes.cell_of_step[steps]
        self._allow0.reshape(-1)[cells] = 1 - bits.astype(np.float32)
        self._allow1.reshape(-1)[cells] = bits
        self.num_parity = end
        self._check_parity()

    def iterate(self, max_iterations: int) -> int:
        """Go on decoding until all received parity is satisfied or the iterations are used up.

        Parameters
        ----------
        max_iterations : int
            Most iterations, each one pass over the whole trellis.

        Returns
        -------
        int
            Iterations done.
        """
        from dvc.turbo import _kernels

        lanes = self._lanes
        flat = [
            a.reshape(-1)
            for a in (self._llr_a, self._llr_e, self._prob0, self._prob1, self._sum0, self._sum1)
        ]
        llr_a, llr_e, prob0, prob1, sum0, sum1 = flat
        for done in range(1, max_iterations + 1):
            _kernels.combine(self._llr_ch, lanes.first_copy, lanes.step_of_copy, llr_e, llr_a, self.llr)
            _kernels.bit_probabilities(llr_a, prob0, prob1)
            _kernels.siso_forward_backward(
                self._trellis.next_state,
                self._trellis.output,
                self._trellis.previous,
                self._prob0,
                self._prob1,
                self._allow0,
                self._allow1,
                self._alpha,
                self._alpha_edge,
                self._beta_edge,
                self._sum0,
                self._sum1,
            )
            self._exchange_edges()
            _kernels.log_ratio(sum0, sum1, llr_e)
            _kernels.combine(self._llr_ch, lanes.first_copy, lanes.step_of_copy, llr_e, llr_a, self.llr)
            if _kernels.decide(self.llr, self.decisions):
                self._check_parity()
            if self.parity_satisfied:
                return done
        return max_iterations

    def _exchange_edges(self) -> None:
        """Hand the metrics at the end of every lane to its neighbour for the next pass."""
        lanes = self._lanes
        alpha = np.roll(self._alpha_edge, 1, axis=1)
        alpha[:, lanes.opens] = 0
        alpha[0, lanes.opens] = 1
        beta = np.roll(self._beta_edge, -1, axis=1)
        beta[:, lanes.closes] = 1 / self._trellis.num_states
        self._alpha_edge, self._beta_edge = alpha, beta

    def _check_parity(self) -> None:
        from dvc.turbo import _kernels

        self.parity_satisfied = (
            _kernels.count_violations(
                self.decisions,
                self._layout.bit_at_step,
                self._starts,
                self._trellis.next_state,
                self._trellis.output,
                self._parity,
            )
            == 0
        )
