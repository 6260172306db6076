"""Answers to what a decoder asks, of frames that a live encoder holds or that were read from a stream."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import (
    KINDS,
    MAX_RUN_BITS,
    Part,
    PlaneCoder,
    RequestTable,
    Round,
    crc_words,
    joint_check,
)
from dvc.slepian_wolf.requests import FRAME, SLOT, Bits
from dvc.wynerziv import _kernels
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout

MAX_HELD_BYTES = 2**28
"""Memory for bits of runs and their parity: if there is more, those of the runs that were begun first are
computed again when they are needed."""
Words = NDArray[np.uint64]
CRC, UNCODED, JOINT = (KINDS.index(kind) for kind in ("crc", "uncoded", "joint"))


@dataclass
class _HeldRun:
    """Bits of a run, and their parity as far as it was asked for."""

    bits: Words  # shape (N,), 0 or 1
    parity: Bits  # of the first codes, one after the other

    @property
    def num_bytes(self) -> int:
        return self.bits.nbytes + self.parity.nbytes


class _PickedPart(NamedTuple):
    """Bits of a frame in a run."""

    slot: int
    planes: tuple[int, ...]
    areas: NDArray[np.bool_]  # shape (planes, areas)


class EncoderBuffer:
    """Frames with requestable bits; the parity of a code is computed at its first request."""

    def __init__(self, layout: FrameLayout, coder: PlaneCoder, num_slots: int) -> None:
        self._layout, self._coder = layout, coder
        self._areas = Areas(layout.band_shape)
        self._frames: list[EncodedFrame | None] = [None] * num_slots
        # Slots of the frames of each run, their planes, and the areas where these are wanted.
        self._runs: list[list[list[_PickedPart]]] = [[] for _ in range(num_slots)]
        self._chosen: list[dict[int, NDArray[np.bool_]]] = [{} for _ in range(num_slots)]  # areas, by planes
        self._held: dict[tuple[int, int], _HeldRun] = {}
        self._num_bytes = 0

    def enter(self, slot: int, frame: EncodedFrame) -> None:
        """Hold a frame, in place of any other that was held there."""
        for number in range(len(self._runs[slot])):
            self._forget(slot, number)
        self._frames[slot], self._runs[slot], self._chosen[slot] = frame, [], {}

    def answer_round(self, requests: Round, first_frame: int) -> list[Bits]:
        """Return the bits that each request asks for, where slots hold the frames from the first one on."""
        table = RequestTable.of(requests)
        table.rows[:, SLOT] = table.rows[:, FRAME] - first_frame
        return table.divided(self.answer(table))

    def answer(self, table: RequestTable) -> bytes:
        """Return the bits that requests ask for."""
        bits, stop, first = np.empty(table.num_bits, np.uint8), 0, 0
        for frame, number, kind, code, start, count, last, slot, begun in table.rows.tolist():
            if begun >= 0:
                self._runs[slot].append([self._picked(slot, part) for part in table.runs[begun]])
            positions, first = table.positions[first:last], last
            answer, stop = slice(stop, stop + count), stop + count
            if kind == JOINT:
                checks = [self._check(slot, run) for run in positions.tolist()]
                bits[answer] = joint_check(np.stack(checks))[:count]
                continue
            if kind == CRC:
                bits[answer] = self._check(slot, number)[start : start + count]
                continue
            run = self._held.get((slot, number)) or self._pick(slot, number)
            size = run.bits.size
            end = int(positions[-1]) if positions.size else start + count - 1
            if end >= size * (self._coder.num_codes - code if positions.size else 1):
                raise ValueError(f"bit {end} of a run of {size} in frame {frame}")
            if kind == UNCODED:
                bits[answer] = run.bits[start : start + count]
                continue
            known = self._parity(run, code + end // size + 1)
            bits[answer] = (
                known[size * code + positions] if positions.size else known[size * code + start :][:count]
            )
        return np.packbits(bits).tobytes()

    def _picked(self, first_slot: int, part: Part) -> _PickedPart:
        """Start a run of planes of a frame in some areas."""
        slot = first_slot + part.offset
        frame, chosen, areas = self._frames[slot], self._chosen[slot], self._areas.decoded(part.areas)
        if frame is None or part.planes[-1] >= frame.quantization.num_planes:
            raise ValueError(f"plane {part.planes[-1]} of a frame")
        for plane in part.planes:
            is_first = plane in frame.quantization.first_plane
            chosen[plane] = areas if is_first else areas & chosen.get(plane - 1, False)
        return _PickedPart(slot, part.planes, np.stack([chosen[plane] for plane in part.planes]))

    def _check(self, slot: int, number: int) -> Words:
        run = self._held.get((slot, number)) or self._pick(slot, number)
        return crc_words(run.bits, self._layout.crc_bits)

    def _pick(self, slot: int, number: int) -> _HeldRun:
        """Pick the bits of a run, again if they have given way."""
        run = self._runs[slot][number]
        sizes = [int(self._areas.sizes @ part.areas.sum(axis=0)) for part in run]
        if sum(sizes) > MAX_RUN_BITS:
            raise ValueError(f"a run of {sum(sizes)} bits, at most {MAX_RUN_BITS} are allowed")
        bits, first = np.empty(sum(sizes), np.uint64), 0
        for part, size in zip(run, sizes, strict=True):
            frame, planes = self._frames[part.slot], np.array(part.planes)
            assert frame is not None
            own = bits[first : first + size]
            _kernels.pick_bits(frame.words, planes, self._areas.of_blocks, part.areas, own)
            first += size
        held = self._held[slot, number] = _HeldRun(bits, np.empty(0, np.uint8))
        self._num_bytes += held.num_bytes
        self._make_room(held)
        return held

    def _make_room(self, wanted: _HeldRun) -> None:
        """Discard the oldest runs, except one that is in use."""
        for place, run in [*self._held.items()]:
            if self._num_bytes <= MAX_HELD_BYTES:
                return
            if run is not wanted:
                self._forget(*place)

    def _forget(self, slot: int, run: int) -> None:
        held = self._held.pop((slot, run), None)
        self._num_bytes -= 0 if held is None else held.num_bytes

    def _parity(self, run: _HeldRun, num_codes: int) -> Bits:
        """Return the parity of a run by the first codes, one after the other."""
        size, known = run.bits.size, run.parity.size // max(run.bits.size, 1)
        if known < num_codes:
            parts, parity = [run.parity], np.empty_like(run.bits)
            for code in range(known, num_codes):
                self._coder.encode(code, run.bits, parity)
                parts.append(parity.astype(np.uint8))
            run.parity = np.concatenate(parts)
            self._num_bytes += size * (num_codes - known)
            self._make_room(run)
        return run.parity
