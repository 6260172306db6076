"""Iterative decoding of one bit plane from its side information and the parity received so far."""

from collections.abc import Callable
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
    bit_of_cell : ndarray of shape (L * W,), int32
        Bit of the plane that enters there; N where a lane is padded.
    """

    num_steps: int
    cell_of_step: NDArray[np.int32]
    opens: NDArray[np.bool_]
    closes: NDArray[np.bool_]
    bit_of_cell: NDArray[np.int32]


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
    bit_of_cell = np.full(num_steps * NUM_LANES, num_bits, np.int32)
    bit_of_cell[cell_of_step] = layout.bit_at_step
    return LaneLayout(num_steps, cell_of_step, opens, closes, bit_of_cell)


@lru_cache(maxsize=64)
def siso_kernel(feedback: int, feedforward: int) -> Callable[..., None]:
    """Return the compiled BCJR pass of an RSC code.

    Parameters
    ----------
    feedback, feedforward : int
        Polynomials in D; bit i is the coefficient of D to the i-th.

    Returns
    -------
    callable
        See `dvc.turbo._kernels.make_siso`.
    """
    from dvc.turbo import _kernels

    table = trellis(feedback, feedforward)
    kernel: Callable[..., None] = _kernels.make_siso(table.num_states, table.input_mask, table.parity_mask)
    return kernel


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
        from dvc.turbo import _kernels

        self.code = code
        self.num_bits = num_bits
        self.interleaver_seed = interleaver_seed
        self._layout = copy_layout(code, num_bits, interleaver_seed)
        self._starts = np.array(self._layout.section_starts, np.int64)
        self._order = release_order(code, num_bits)
        self._lanes = lane_layout(code, num_bits, interleaver_seed)
        self._trellis: Trellis = trellis(code.feedback, code.feedforward)
        self._record = _kernels.ROW_METRIC + self._trellis.num_states
        self._work = np.zeros((self._lanes.num_steps + 1, self._record, _kernels.NUM_LANES), np.float32)
        self._messages = np.zeros((4, self._lanes.num_steps * _kernels.NUM_LANES), np.float32)
        self._edges = np.empty((2, self._trellis.num_states * _kernels.NUM_LANES), np.float32)
        self._siso = siso_kernel(code.feedback, code.feedforward)
        self._parity = np.full(self._layout.num_steps, -1, np.int8)
        self._llr_ch = np.zeros(num_bits + 1, np.float32)
        self._llr = np.zeros(num_bits + 1, np.float32)
        self.decisions: NDArray[np.uint8] = np.zeros(num_bits, np.uint8)
        self.num_parity = 0
        self.parity_satisfied = True

    @property
    def llr(self) -> NDArray[np.float32]:
        """A posteriori LLRs of the bits, shape (N,), float32; a view of the decoder's state."""
        return self._llr[:-1]

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
        self._llr_ch[:-1] = np.clip(llr, -MAX_CHANNEL_LLR, MAX_CHANNEL_LLR)
        self._messages.fill(0)
        self._work[:, :2] = 1
        self._parity.fill(-1)
        lanes, edges = self._lanes, self._edges.reshape(2, self._trellis.num_states, -1)
        edges.fill(1)
        edges[0, 1:, lanes.opens] = 0
        self._llr[:] = self._llr_ch
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
        t, lane = np.divmod(self._lanes.cell_of_step[steps], self._work.shape[2])
        self._work[t, 0, lane] = 1 - bits.astype(np.float32)
        self._work[t, 1, lane] = bits
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

        lanes, table = self._lanes, self._trellis
        lane_arrays = (lanes.bit_of_cell, lanes.opens, lanes.closes)
        code_bits = (self._layout.bit_at_step, self._starts, self._parity)
        tables = (table.next_state, table.output)
        work = self._work.reshape(-1)
        prob0, prob1 = self._messages[2], self._messages[3]
        _kernels.prepare_pass(self._llr_ch, lanes.bit_of_cell, self._messages, self._llr)
        for done in range(1, max_iterations + 1):
            self._siso(prob0, prob1, work, self._edges)
            self.parity_satisfied = _kernels.finish_pass(
                lane_arrays,
                code_bits,
                tables,
                self._llr_ch,
                work,
                self._edges,
                self._messages,
                self._llr,
                self.decisions,
            )
            if self.parity_satisfied:
                return done
        return max_iterations

    def _check_parity(self) -> None:
        from dvc.turbo import _kernels

        self.parity_satisfied = _kernels.satisfies(
            self.decisions,
            self._layout.bit_at_step,
            self._starts,
            self._trellis.next_state,
            self._trellis.output,
            self._parity,
        )
