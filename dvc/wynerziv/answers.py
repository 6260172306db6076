"""Answers to many requests at once: what a live encoder holds of the frames that its decoder works at."""

from collections.abc import Sequence

import numpy as np

from dvc import turbo
from dvc.turbo.crc import POLYNOMIALS
from dvc.wynerziv import _kernels
from dvc.wynerziv.buffered import EncodedFrame
from dvc.wynerziv.layout import FrameLayout

PATIENCE = 64
"""Messages answered since a frame was last asked for, from which on its parity gives way to others."""


class OpenFrames:
    """Frames of which bits may be asked for; parity of a code is computed when it is first asked for.

    Many frames may be open, but decoders work at few of them at a time: only these keep their parity.

    Parameters
    ----------
    layout : FrameLayout
        Layout of the frames.
    encoders : sequence of callable
        What computes the parity of each code, from `turbo.parity_encoders`.
    num_slots : int
        Places for frames, which take memory once they are used.
    """

    def __init__(self, layout: FrameLayout, encoders: Sequence[turbo.ParityEncoder], num_slots: int) -> None:
        self._encoders = encoders
        self._num_bits = layout.num_bits
        self._polynomial = np.uint64(POLYNOMIALS[layout.crc_bits])
        num_rows, num_codes = -(-sum(layout.max_planes) // 64), len(encoders)
        self._num_planes = np.zeros(num_slots, np.int64)
        self._words = np.empty((num_slots, num_rows, layout.num_bits), np.uint64)
        self._checks = np.zeros((num_slots, num_rows, layout.crc_bits), np.uint64)
        self._places, self._owners = np.full((2, num_slots), -1)
        self._last_use = np.zeros(num_slots, np.int64)
        self._known = np.zeros((num_slots, num_rows, num_codes), np.bool_)
        self._parity = np.empty((num_slots, num_rows, num_codes, layout.num_bits), np.uint64)
        self._num_calls = 0

    def enter(self, slot: int, frame: EncodedFrame) -> None:
        """Hold a frame, in place of any other that was held there.

        Parameters
        ----------
        slot : int
            Where.
        frame : EncodedFrame
            The frame.
        """
        num_rows = len(frame.words)
        self._num_planes[slot] = frame.quantization.num_planes
        self._words[slot, :num_rows] = frame.words
        self._checks[slot, :num_rows] = frame.checks
        if self._places[slot] >= 0:
            self._owners[self._places[slot]] = -1
            self._places[slot] = -1

    def answer(self, table: turbo.RequestTable) -> bytes:
        """Return the bits that requests ask for.

        Parameters
        ----------
        table : RequestTable
            The requests, in bounds for all frames of the layout, with the slots of their frames.

        Returns
        -------
        bytes
            The bits, one request's after the other's, filled up to a byte with zeros.

        Raises
        ------
        ValueError
            If a frame has fewer planes.
        """
        rows, positions, num_bits = table
        self._compute_missing(table)
        packed = np.empty(-(-num_bits // 8), np.uint8)
        _kernels.answer_requests(
            rows, positions, self._words, self._checks, self._places, self._parity, self._polynomial, packed
        )
        return packed.tobytes()

    def _compute_missing(self, table: turbo.RequestTable) -> None:
        """Compute the parity that requests need and that is not known."""
        missing = np.empty((len(table.rows) * len(self._encoders), 3), np.int64)
        self._num_calls += 1
        count = _kernels.missing_parity(
            table.rows, table.positions, self._num_bits, self._num_planes, self._places, self._owners,
            self._last_use, self._known, self._num_calls, PATIENCE, missing,
        )  # fmt: skip
        if count < 0:
            request = table.requests()[-1 - count]
            raise ValueError(f"plane {max(request.plane, *request.positions, 0)} of frame {request.frame}")
        for slot, row, code in missing[:count].tolist():
            self._encoders[code](self._words[slot, row], self._parity[self._places[slot], row, code])
