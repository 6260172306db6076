"""Account of groups of pictures, credits and requests of the feedback channel.

All methods raise `ValueError` for a step that the protocol forbids: a mistake of the caller if the step is
its own, a breach of the protocol if it is the peer's. Both ends account for groups; requests are checked in
one place, `RequestAccount` of the encoder.
"""

from collections import deque

import numpy as np

from dvc.config import CodecConfig
from dvc.config.sections import NUM_BANDS
from dvc.feedback import _kernels
from dvc.feedback.messages import MAX_ANSWER_BITS
from dvc.slepian_wolf import CRC_BITS, KINDS, RequestTable, Run, plane_coder
from dvc.slepian_wolf.requests import BEGUN, FRAME, RUN, SLOT

MAX_OPEN_GOPS = 32
"""Largest number of groups of pictures that are sent or promised but not done."""
MAX_OPEN_PX = 2**26
"""Largest number of pixels of all their frames, unless that leaves fewer than two groups."""
MAX_RUNS = 256
"""Largest number of runs that a frame may name."""

_FAULTS = {
    _kernels.NO_FRAME: "the frame is not a Wyner-Ziv frame of an open group of pictures",
    _kernels.NO_RUN: "this run, or another one that it names, has not begun",
    _kernels.UNANSWERED: "the previous request for this run is not answered yet",
    _kernels.TOO_MANY: "the run does not have that many bits",
    _kernels.NO_CODE: "no such code",
    _kernels.TOO_MANY_JOINT: "too many joint bits at once",
    _kernels.WRONG_FIRST_RUN: "the first run of joint bits must be its own",
    _kernels.WRONG_COUNT: "as many positions as bits are required",
    _kernels.NEEDLESS_POSITIONS: "this kind has no positions",
    _kernels.BAD_POSITIONS: "positions must increase and lie within the orders of the run",
}


def max_open_gops(config: CodecConfig) -> int:
    """Return how many groups of pictures may be sent or promised, and not done.

    Parameters
    ----------
    config : CodecConfig
        Configuration, which gives their size.

    Returns
    -------
    int
        From 2 to `MAX_OPEN_GOPS`.
    """
    group_px = config.video.width * config.video.height * config.gop.length
    return min(max(MAX_OPEN_PX // group_px, 2), MAX_OPEN_GOPS)


class FlowControl:
    """Account of groups of pictures, from the first group and frame of a connection on."""

    def __init__(self, config: CodecConfig, first_group: int = 0, first_frame: int = 0) -> None:
        self.num_credits = 0  # groups of pictures that may be sent
        self.num_groups, self.num_frames = first_group, first_frame  # before the next group
        self.ended = False
        self.open: set[int] = set()
        self._max_open, self._gop_length = max_open_gops(config), config.gop.length
        self._has_predicted = config.key.predicted

    @property
    def all_done(self) -> bool:
        """Whether the end was announced and all groups of pictures are done."""
        return self.ended and not self.open

    def add_credit(self) -> None:
        """Allow one more group of pictures."""
        if self.num_credits + len(self.open) >= self._max_open:
            raise ValueError(f"more than {self._max_open} groups of pictures open")
        self.num_credits += 1

    def open_gop(self, number: int, num_frames: int, predicted: bool = False) -> None:
        """Enter a group of pictures."""
        if self.ended:
            raise ValueError("a group of pictures after the end")
        if self.num_credits == 0:
            raise ValueError("a group of pictures that was not asked for")
        if number != self.num_groups:
            raise ValueError(f"group of pictures {number}, expected {self.num_groups}")
        limit = self._gop_length if number else 1
        if num_frames > limit:
            raise ValueError(
                f"{num_frames} frames in group of pictures {number}, at most {limit} are allowed"
            )
        if predicted and not (number and self._has_predicted):
            raise ValueError(f"the key frame of group of pictures {number} cannot be predicted")
        self.open.add(number)
        self.num_credits -= 1
        self.num_groups += 1
        self.num_frames += num_frames

    def close_gop(self, number: int) -> None:
        """Remove a group of pictures that is done."""
        if number not in self.open:
            raise ValueError(f"group of pictures {number} is not open")
        if number != min(self.open):
            raise ValueError(f"group of pictures {number} is done before group {min(self.open)}")
        self.open.remove(number)

    def end(self, num_frames: int) -> None:
        """Enter the end of the sequence."""
        if self.ended:
            raise ValueError("a second end")
        if num_frames != self.num_frames:
            raise ValueError(f"end after {num_frames} frames, but {self.num_frames} were sent")
        self.ended = True


class RequestAccount:
    """Account of the requests of a decoder for frames of open groups of pictures, which are held in slots."""

    def __init__(self, config: CodecConfig) -> None:
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
            config.gop.length, np.array([limits[kind] for kind in KINDS]), CRC_BITS, coder.num_codes
        )
        num_slots = max_open_gops(config) * config.gop.length
        runs = num_slots, MAX_RUNS
        self._frames = _kernels.OpenFrames(
            np.zeros((max_open_gops(config), 2), np.int64),
            np.zeros((*runs, len(KINDS)), np.int32),
            np.zeros(runs, np.int32),
            np.zeros(runs, np.int32),
        )
        self._num_runs = [0] * num_slots
        self._begun = [0] * num_slots  # bit mask of the planes that are in a run
        self._rows: dict[int, int] = {}  # rows of the table of open groups, by group number
        self._waiting: deque[RequestTable] = deque()

    def open_gop(self, number: int, first_frame: int, num_frames: int) -> int:
        """Enter the Wyner-Ziv frames of a group of pictures; return the slot of the first."""
        row = min({*range(len(self._frames.gops))} - {*self._rows.values()})
        start: int = row * self._rules.gop_length
        slots = slice(start, start + self._rules.gop_length)
        self._frames.requested[slots] = 0
        self._frames.num_planes[slots] = 0
        self._num_runs[slots] = self._begun[slots] = [0] * self._rules.gop_length
        self._frames.gops[row] = first_frame, num_frames
        self._rows[number] = row
        return start

    def close_gop(self, number: int) -> None:
        """Remove a group of pictures that is done."""
        row = self._rows[number]
        start = row * self._rules.gop_length
        if self._frames.awaited[start : start + self._rules.gop_length].any():
            raise ValueError(f"group of pictures {number} is done before all its requests are answered")
        self._frames.gops[row] = 0
        del self._rows[number]

    def request(self, table: RequestTable) -> None:
        """Enter the requests of a message; fill in the slots of their frames and their first bits."""
        if not len(table.rows) or table.num_bits > MAX_ANSWER_BITS:
            raise ValueError(f"{table.num_bits} bits requested at once, not 1 to {MAX_ANSWER_BITS}")
        for row, run in zip(table.rows[table.rows[:, BEGUN] >= 0], table.runs, strict=True):
            self._begin(int(row[FRAME]), int(row[RUN]), run)
        number, fault = _kernels.enter_requests(table.rows, table.positions, self._frames, self._rules)
        if fault:
            request = table.requests()[number]
            name = f"{request.count} {request.kind} bits of run {request.run} of frame {request.frame}"
            raise ValueError(f"{name}: {_FAULTS[fault]}")
        self._waiting.append(table)

    def _begin(self, frame: int, number: int, run: Run) -> None:
        """Enter a run."""
        gops, name = self._frames.gops, f"run {number} of frame {frame}"
        slot = int(_kernels.slot_of(frame, gops, self._rules.gop_length))
        if slot < 0:
            return  # its first request is refused
        if number != self._num_runs[slot] or number >= MAX_RUNS:
            raise ValueError(f"{name} begins, expected {self._num_runs[slot]} of at most {MAX_RUNS}")
        first, count = gops[slot // self._rules.gop_length].tolist()
        offsets = [part.offset for part in run]
        if not run or offsets != sorted({*offsets}) or offsets[0] < 0 or frame + offsets[-1] >= first + count:
            raise ValueError(f"{name} has frames at the offsets {offsets}")
        for part in run:
            planes = list(part.planes)
            if not 0 < len(planes) <= NUM_BANDS or len(part.areas) > self._max_areas_bytes:
                raise ValueError(f"{name} has {len(planes)} planes, areas of {len(part.areas)} bytes")
            if planes != sorted({*planes}) or planes[0] < 0 or planes[-1] >= self._num_planes:
                raise ValueError(f"{name} has planes {planes} of {self._num_planes}")
            begun = sum(1 << plane for plane in planes)
            if begun & self._begun[slot + part.offset]:
                raise ValueError(f"{name} has planes {planes}, some already in another run")
            self._begun[slot + part.offset] |= begun
        self._num_runs[slot] += 1
        self._frames.num_planes[slot, number] = sum(len(part.planes) for part in run)

    def answer(self) -> RequestTable:
        """Remove the first unanswered requests, which are answered now."""
        if not self._waiting:
            raise ValueError("bits that were not requested")
        table = self._waiting.popleft()
        self._frames.awaited[table.rows[:, SLOT], table.rows[:, RUN]] = 0
        return table
