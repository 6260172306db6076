"""Answers to what a decoder asks, of frames that a live encoder holds or that were read from a stream."""

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import PlaneCoder, RequestTable, Round, Run, crc_words, joint_check
from dvc.slepian_wolf.requests import SLOT, Bits, ParityRequest
from dvc.wynerziv import _kernels
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout

MAX_HELD_BYTES = 2**28
"""Memory for bits of runs and their parity: if there is more, that of the run that was asked for longest ago
is computed again when it is needed."""
Words = NDArray[np.uint64]


@dataclass
class _HeldRun:
    """Bits of a run, and their parity as far as it was asked for."""

    bits: Words  # shape (N,), 0 or 1
    parity: dict[int, Words] = field(default_factory=dict)  # by codes

    @property
    def num_bytes(self) -> int:
        return self.bits.nbytes * (1 + len(self.parity))


class EncoderBuffer:
    """Frames of which bits may be asked for; parity of a code is computed when it is first asked for."""

    def __init__(self, layout: FrameLayout, coder: PlaneCoder, num_slots: int) -> None:
        self._layout, self._coder = layout, coder
        self._areas = Areas(layout.band_shape)
        self._frames: list[EncodedFrame | None] = [None] * num_slots
        self._runs: list[dict[int, Run]] = [{} for _ in range(num_slots)]  # by their first planes
        self._chosen: list[dict[int, NDArray[np.bool_]]] = [{} for _ in range(num_slots)]  # areas, by planes
        self._held: OrderedDict[tuple[int, int], _HeldRun] = OrderedDict()
        self._num_bytes = 0

    @classmethod
    def of(cls, frame: EncodedFrame, coder: PlaneCoder) -> Self:
        """Return a buffer of one frame."""
        buffer = cls(frame.layout, coder, 1)
        buffer.enter(0, frame)
        return buffer

    def enter(self, slot: int, frame: EncodedFrame) -> None:
        """Hold a frame, in place of any other that was held there."""
        for plane in self._runs[slot]:
            self._forget(slot, plane)
        self._frames[slot], self._runs[slot], self._chosen[slot] = frame, {}, {}

    def answer_round(self, requests: Round) -> list[Bits]:
        """Return the bits that each request asks for, of the one frame."""
        return [self._answer(0, request) for request in requests]

    def answer(self, table: RequestTable) -> bytes:
        """Return the bits that requests ask for."""
        slots = table.rows[:, SLOT].tolist()
        found = map(self._answer, slots, table.requests())
        return np.packbits(np.concatenate([*found])).tobytes()

    def _answer(self, slot: int, request: ParityRequest) -> Bits:
        if request.run is not None:
            self._begin(slot, request)
        if request.kind == "joint":
            checks = [self._check(slot, plane) for plane in request.positions]
            return joint_check(np.stack(checks))[: request.count]
        first, stop = request.start, request.start + request.count
        if request.kind == "crc":
            return self._check(slot, request.plane)[first:stop].astype(np.uint8)
        run = self._run(slot, request.plane)
        last = request.positions[-1] if request.positions else stop - 1
        if last >= run.bits.size * (self._coder.num_codes - request.code if request.positions else 1):
            raise ValueError(f"bit {last} of a run of {run.bits.size} in frame {request.frame}")
        if request.kind == "uncoded":
            return run.bits[first:stop].astype(np.uint8)
        if not request.positions:
            return self._parity(run, request.code)[first:stop].astype(np.uint8)
        positions, code = np.array(request.positions), request.code
        ends = np.searchsorted(positions, np.arange(run.bits.size, positions[-1] + 1, run.bits.size))
        parts = [
            self._parity(run, code + number)[part - number * run.bits.size]
            for number, part in enumerate(np.split(positions, ends))
            if part.size
        ]
        return np.concatenate(parts).astype(np.uint8)

    def _begin(self, slot: int, request: ParityRequest) -> None:
        run, frame = request.run, self._frames[slot]
        assert run is not None
        if frame is None or run.planes[-1] >= frame.quantization.num_planes:
            raise ValueError(f"plane {run.planes[-1]} of frame {request.frame}")
        chosen, areas = self._chosen[slot], self._areas.decoded(run.areas)
        for plane in run.planes:
            is_first = plane in frame.quantization.first_plane
            chosen[plane] = areas if is_first else areas & chosen.get(plane - 1, False)
        self._runs[slot][request.plane] = run

    def _check(self, slot: int, plane: int) -> Words:
        return crc_words(self._run(slot, plane).bits, self._layout.crc_bits)

    def _run(self, slot: int, plane: int) -> _HeldRun:
        """Return a run, whose bits are picked again if they have given way."""
        held = self._held.get((slot, plane))
        if held is None:
            run, frame = self._runs[slot][plane], self._frames[slot]
            assert frame is not None
            chosen = np.stack([self._chosen[slot][own] for own in run.planes])
            bits = np.empty(int(self._areas.sizes @ chosen.sum(axis=0)), np.uint64)
            _kernels.pick_bits(frame.words, np.array(run.planes), self._areas.of_blocks, chosen, bits)
            held = self._held[slot, plane] = _HeldRun(bits)
            self._num_bytes += bits.nbytes
        self._held.move_to_end((slot, plane))
        self._make_room()
        return held

    def _make_room(self) -> None:
        """Let runs give way, but not the one that was asked for last."""
        while self._num_bytes > MAX_HELD_BYTES and len(self._held) > 1:
            self._forget(*next(iter(self._held)))

    def _forget(self, slot: int, plane: int) -> None:
        held = self._held.pop((slot, plane), None)
        self._num_bytes -= 0 if held is None else held.num_bytes

    def _parity(self, run: _HeldRun, code: int) -> Words:
        if code not in run.parity:
            run.parity[code] = np.empty_like(run.bits)
            self._coder.encode(code, run.bits, run.parity[code])
            self._num_bytes += run.bits.nbytes
            self._make_room()
        return run.parity[code]
