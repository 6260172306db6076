"""What is open on the feedback channel (groups of pictures, credits, requests), as both ends see it.

All methods raise `ValueError` for a step that the protocol does not allow: a mistake of the caller if the
step is its own, a breach of the protocol if it is the peer's.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from dvc.config import CodecConfig
from dvc.config.sections import NUM_BANDS
from dvc.feedback import _kernels
from dvc.feedback.messages import MAX_ANSWER_BITS
from dvc.slepian_wolf import CRC_BITS, KINDS, MAX_RUN_BITS, RequestTable, Run, plane_coder
from dvc.slepian_wolf.requests import BEGUN, FRAME, RUN, SLOT

MAX_OPEN_GOPS = 32
"""Most groups of pictures that are sent or promised and not done."""
MAX_OPEN_PX = 2**26
"""Most pixels of all their frames, where that leaves two groups; so both ends need bounded memory."""
MAX_RUNS = 256
"""Most runs that a frame may name."""


def max_open_gops(config: CodecConfig) -> int:
    """Return how many groups of pictures may be sent or promised, and not done.

    Parameters
    ----------
    config : CodecConfig
        Tells how large they are.

    Returns
    -------
    int
        From 2 to `MAX_OPEN_GOPS`.
    """
    group_px = config.video.width * config.video.height * config.gop.length
    return min(max(MAX_OPEN_PX // group_px, 2), MAX_OPEN_GOPS)


@dataclass(frozen=True)
class _OpenGop:
    row: int  # of the table of groups that may be open
    slots: slice


class FlowControl:
    """Accounts for groups of pictures and requests, and says what may not be."""

    def __init__(self, config: CodecConfig) -> None:
        self.num_credits = 0  # groups of pictures that may be sent
        self.num_frames = 0  # of all groups of pictures sent
        self.ended = False
        self._has_predicted = config.key.predicted
        self._max_areas_bytes = 64 + config.video.num_blocks
        self._num_planes = sum(config.wyner_ziv.max_planes)
        coder = plane_coder(config)
        limits = {
            "crc": CRC_BITS,
            "parity": config.video.num_blocks,
            "uncoded": config.video.num_blocks,
            "joint": MAX_RUNS * CRC_BITS if coder.by_positions else 0,
        }
        self._rules = _kernels.Rules(
            config.gop.length,
            np.array([limits[kind] for kind in KINDS]),
            CRC_BITS,
            coder.num_codes,
        )
        self._num_gops = 0
        self.num_slots = max_open_gops(config) * config.gop.length
        runs = self.num_slots, MAX_RUNS
        self._frames = _kernels.OpenFrames(
            np.zeros((max_open_gops(config), 2), np.int64),
            np.zeros((*runs, len(KINDS)), np.int32),
            np.zeros(runs, np.int32),
            np.zeros(runs, np.int32),
        )
        self._num_runs = [0] * self.num_slots
        self._begun = [0] * self.num_slots  # planes that are in a run, a bit each
        self._waiting: deque[RequestTable] = deque()
        self._open: dict[int, _OpenGop] = {}
        self._free = list(range(max_open_gops(config)))

    @property
    def num_gops(self) -> int:
        """Number of groups of pictures sent so far."""
        return self._num_gops

    @property
    def finished(self) -> bool:
        """Whether the end was announced and all groups of pictures are done."""
        return self.ended and not self._open

    def add_credit(self) -> None:
        """Allow one more group of pictures."""
        if self.num_credits >= len(self._free):
            raise ValueError(f"more than {len(self._frames.gops)} groups of pictures open")
        self.num_credits += 1

    def open_gop(self, number: int, num_frames: int, predicted: bool = False) -> None:
        """Enter a group of pictures."""
        if self.ended:
            raise ValueError("a group of pictures after the end")
        if self.num_credits == 0:
            raise ValueError("a group of pictures that was not asked for")
        if number != self._num_gops:
            raise ValueError(f"group of pictures {number} where {self._num_gops} is the next")
        limit = self._rules.gop_length if number else 1
        if num_frames > limit:
            raise ValueError(
                f"{num_frames} frames in group of pictures {number}, at most {limit} are allowed"
            )
        if predicted and not (number and self._has_predicted):
            raise ValueError(f"the key frame of group of pictures {number} cannot be predicted")
        row = self._free.pop()
        slots = slice(row * self._rules.gop_length, (row + 1) * self._rules.gop_length)
        self._frames.requested[slots] = 0
        self._frames.num_planes[slots] = 0
        self._num_runs[slots] = self._begun[slots] = [0] * self._rules.gop_length
        self._frames.gops[row] = self.num_frames, num_frames - 1
        self._open[number] = _OpenGop(row, slots)
        self.num_credits -= 1
        self._num_gops += 1
        self.num_frames += num_frames

    def first_slot(self, number: int) -> int:
        """Return where the first frame of an open group of pictures is held, the others behind it."""
        return int(self._open[number].slots.start)

    def request(self, table: RequestTable, in_turn: bool = False) -> None:
        """Enter requests that go in one message; where frames are held is written to the table."""
        if not len(table.rows) or table.num_bits > MAX_ANSWER_BITS:
            raise ValueError(f"{table.num_bits} bits asked for at once, not 1 to {MAX_ANSWER_BITS}")
        for row, run in zip(table.rows[table.rows[:, BEGUN] >= 0], table.runs, strict=True):
            self._begin(int(row[FRAME]), int(row[RUN]), run)
        number, fault = _kernels.enter_requests(
            table.rows, table.positions, self._frames, self._rules, in_turn
        )
        if fault:
            raise ValueError(self._complaint(table, number, fault))
        self._waiting.append(table)

    def _begin(self, frame: int, number: int, run: Run) -> None:
        """Enter a run."""
        gops, where = self._frames.gops, f"run {number} of frame {frame}"
        slot = int(_kernels.slot_of(frame, gops, self._rules.gop_length))
        if slot < 0:
            return  # which the first request tells
        if number != self._num_runs[slot] or number >= MAX_RUNS:
            raise ValueError(f"{where} begins, {self._num_runs[slot]} is the next of {MAX_RUNS}")
        first, count = gops[slot // self._rules.gop_length].tolist()
        offsets = [part.offset for part in run]
        if not run or offsets != sorted({*offsets}) or offsets[0] < 0 or frame + offsets[-1] >= first + count:
            raise ValueError(f"{where} has frames {offsets} after that")
        for part in run:
            planes = list(part.planes)
            if not 0 < len(planes) <= NUM_BANDS or len(part.areas) > self._max_areas_bytes:
                raise ValueError(f"{where} has {len(planes)} planes, areas of {len(part.areas)} bytes")
            if planes != sorted({*planes}) or planes[0] < 0 or planes[-1] >= self._num_planes:
                raise ValueError(f"{where} has planes {planes}, there are {self._num_planes}")
            begun = sum(1 << plane for plane in planes)
            if begun & self._begun[slot + part.offset]:
                raise ValueError(f"{where} has planes {planes}, of which some are in another run")
            self._begun[slot + part.offset] |= begun
        self._num_runs[slot] += 1
        self._frames.num_planes[slot, number] = sum(len(part.planes) for part in run)

    def _complaint(self, table: RequestTable, number: int, fault: int) -> str:
        """Say in words why a request may not be."""
        request = table.requests()[number]
        kind, count, start, positions = request.kind, request.count, request.start, request.positions
        where = f"run {request.run} of frame {request.frame}"
        slot, run = int(table.rows[number, SLOT]), min(request.run, MAX_RUNS - 1)
        known = self._frames.requested[slot, run, KINDS.index(kind)]
        size = min(self._rules.limits[_kernels.PARITY] * self._frames.num_planes[slot, run], MAX_RUN_BITS)
        last = (MAX_RUNS if kind == "joint" else (self._rules.num_codes - request.code) * size) - 1
        return {
            _kernels.NO_FRAME: f"frame {request.frame} is no Wyner-Ziv frame of an open group of pictures",
            _kernels.NO_RUN: f"{kind} bits of {where}, or another one that was not begun",
            _kernels.SECOND: f"a second request for {where} before the answer to the first",
            _kernels.OUT_OF_TURN: f"{kind} bits of {where} from number {start} on, where {known} is the next",
            _kernels.TOO_MANY: f"{count} {kind} bits of {where} from number {start} on",
            _kernels.NO_CODE: f"code {request.code} for {where}",
            _kernels.TOO_MANY_JOINT: f"{count} joint bits of {where} at once",
            _kernels.OTHER_RUNS: f"joint bits of other runs than {where}",
            _kernels.OTHER_COUNT: f"{count} {kind} bits of {where} at {len(positions)} positions",
            _kernels.NEEDLESS_POSITIONS: f"positions of {kind} bits of {where}",
            _kernels.NO_POSITIONS: f"positions of {kind} bits of {where} must increase from 0 to {last}",
        }[fault]

    def answer(self) -> RequestTable:
        """Enter the answer to the first requests without one."""
        if not self._waiting:
            raise ValueError("bits that were not asked for")
        table = self._waiting.popleft()
        _kernels.enter_answers(table.rows, self._frames.awaited)
        return table

    def close_gop(self, number: int) -> None:
        """Strike out a group of pictures."""
        if number not in self._open:
            raise ValueError(f"group of pictures {number} is not open")
        gop = self._open[number]
        if self._frames.awaited[gop.slots].any():
            raise ValueError(f"group of pictures {number} is done before all its requests are answered")
        self._frames.gops[gop.row] = 0
        self._free.append(gop.row)
        del self._open[number]

    def end(self, num_frames: int) -> None:
        """Enter the end of the sequence."""
        if self.ended:
            raise ValueError("a second end")
        if num_frames != self.num_frames:
            raise ValueError(f"end after {num_frames} frames, but {self.num_frames} were sent")
        self.ended = True
