"""Answers to many requests at once: what a live encoder holds of the frames that its decoder works at."""

from collections.abc import Sequence

import numpy as np

from dvc import turbo
from dvc.turbo.crc import POLYNOMIALS
from dvc.turbo.requests import SLOT
from dvc.wynerziv import _kernels
from dvc.wynerziv.buffered import EncodedFrame
from dvc.wynerziv.layout import FrameLayout

PATIENCE = 64
"""Messages answered since a frame was last asked for, from which on its parity gives way to others."""

FIRST_WORDS = 2**27
"""Words of parity for which there is room at first, for one frame at least; more where that is needed."""


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
        self._places = np.full(num_slots, -1)
        self._owners, self._last_use = np.empty(0, np.int64), np.empty(0, np.int64)
        self._known = np.empty((0, num_rows, num_codes), np.bool_)
        self._parity = np.empty((0, num_rows, num_codes, layout.num_bits), np.uint64)
        self._num_calls = 0
        self._add_places(min(num_slots, max(1, FIRST_WORDS // (num_rows * num_codes * layout.num_bits))))

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
        done = 0
        while done < len(table.rows):
            count, done = _kernels.missing_parity(
                table.rows, table.positions, self._num_bits, self._num_planes, self._places, self._owners,
                self._last_use, self._known, self._num_calls, PATIENCE, missing,
            )  # fmt: skip
            for slot, row, code in missing[:count].tolist():
                self._encoders[code](self._words[slot, row], self._parity[self._places[slot], row, code])
            if done < len(table.rows):
                self._refuse_other_planes(table, done)
                self._add_places(min(len(self._owners), len(self._places) - len(self._owners)))

    def _refuse_other_planes(self, table: turbo.RequestTable, number: int) -> None:
        request = table.requests()[number]
        plane = max(request.plane, request.positions[-1] if request.kind == "joint" else 0)
        if plane >= self._num_planes[table.rows[number, SLOT]]:
            raise ValueError(f"plane {plane} of frame {request.frame}")

    def _add_places(self, count: int) -> None:
        """Make room for the parity of more frames, which takes memory once it is used."""
        self._owners = np.concatenate([self._owners, np.full(count, -1)])
        self._last_use = np.concatenate([self._last_use, np.zeros(count, np.int64)])
        self._known = np.concatenate([self._known, np.zeros((count, *self._known.shape[1:]), np.bool_)])
        parity = np.empty((len(self._owners), *self._parity.shape[1:]), np.uint64)
        for place in np.flatnonzero(self._owners >= 0):  # the others hold nothing, and take no memory yet
            parity[place] = self._parity[place]
        self._parity = parity
