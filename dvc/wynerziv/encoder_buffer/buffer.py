"""Answers to many requests at once, of frames that a live encoder holds or that were read from a stream."""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import PlaneCoder, RequestTable, Round
from dvc.slepian_wolf.crc import POLYNOMIALS
from dvc.slepian_wolf.requests import SLOT, Bits
from dvc.wynerziv.encoder_buffer import _kernels
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout

PATIENCE = 64
"""Messages answered since a frame was last asked for, from which on its parity gives way to others."""
MAX_PARITY_BYTES = 2**30
"""Memory for parity, at least that of one frame: where more is asked for, parity of the frames that were
asked for longest ago gives way, and is computed again when it is needed."""


class EncoderBuffer:
    """Frames of which bits may be asked for; parity of a code is computed when it is first asked for."""

    def __init__(self, layout: FrameLayout, coder: PlaneCoder, num_slots: int) -> None:
        self._coder = coder
        num_rows, num_codes = -(-sum(layout.max_planes) // 64), coder.num_codes
        per_frame = num_rows * num_codes
        num_places = min(num_slots * per_frame, max(per_frame, MAX_PARITY_BYTES // (8 * layout.num_bits)))
        self._frames = _kernels.HeldFrames(
            num_planes=np.zeros(num_slots, np.int64),
            words=np.empty((num_slots, num_rows, layout.num_bits), np.uint64),
            checks=np.zeros((num_slots, num_rows, layout.crc_bits), np.uint64),
            places=np.full((num_slots, num_rows, num_codes), -1),
            last_use=np.zeros(num_slots, np.int64),
            owners=np.full((num_places, 3), -1),
            parity=np.empty((num_places, layout.num_bits), np.uint64),  # takes memory once it is used
            polynomial=POLYNOMIALS[layout.crc_bits],
            patience=PATIENCE,
        )
        self._missing = np.empty((0, 4), np.int64)
        self._num_passes = 0

    @classmethod
    def of(cls, frame: EncodedFrame, coder: PlaneCoder) -> Self:
        """Return a buffer of one frame."""
        buffer = cls(frame.layout, coder, 1)
        buffer.enter(0, frame)
        return buffer

    def enter(self, slot: int, frame: EncodedFrame) -> None:
        """Hold a frame, in place of any other that was held there."""
        frames, num_rows = self._frames, len(frame.words)
        frames.num_planes[slot] = frame.quantization.num_planes
        frames.words[slot, :num_rows] = frame.words
        frames.checks[slot, :num_rows] = frame.checks
        places = frames.places[slot]
        frames.owners[places[places >= 0]] = -1
        places[:] = -1

    def answer_round(self, requests: Round) -> list[Bits]:
        """Return the bits that each request asks for, of the one frame."""
        table = RequestTable.of(requests)
        return table.divided(self.answer(table))

    def answer(self, table: RequestTable) -> bytes:
        """Return the bits that requests ask for."""
        rows, positions, num_bits = table
        packed = np.empty(-(-num_bits // 8), np.uint8)
        done = written = 0
        while done < len(rows):  # again where parity of so many frames has no room at a time
            first, missing = done, self._room_for_missing(len(rows))
            self._num_passes += 1
            count, done, written = _kernels.answer_known(
                rows, positions, first, self._frames, self._num_passes, missing, written, packed
            )
            if count:
                self._compute(missing[:count])
                written = _kernels.answer_requests(
                    rows, positions, first, done, self._frames, written, packed
                )
            if done < len(rows):
                self._refuse_other_planes(table, done)
        return packed.tobytes()

    def _room_for_missing(self, num_requests: int) -> NDArray[np.int64]:
        """Return room for a list of the parity that so many requests may need."""
        if len(self._missing) < num_requests * self._coder.num_codes:
            self._missing = np.empty((num_requests * self._coder.num_codes, 4), np.int64)
        return self._missing

    def _compute(self, missing: NDArray[np.int64]) -> None:
        """Compute parity; `missing` (n, 4) has slot, row, code and place of each."""
        for slot, row, code, place in missing.tolist():
            self._coder.encode(code, self._frames.words[slot, row], self._frames.parity[place])

    def _refuse_other_planes(self, table: RequestTable, number: int) -> None:
        request = table.requests()[number]
        plane = max(request.plane, request.positions[-1] if request.kind == "joint" else 0)
        if plane >= self._frames.num_planes[table.rows[number, SLOT]]:
            raise ValueError(f"plane {plane} of frame {request.frame}")
