"""Compiled loops over many requests, their syntax and what flow control says of them; validated by callers.

`rows` (n, 9) and `positions` (m,) are the columns of a `dvc.slepian_wolf.RequestTable`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.bits import MAX_VARINT_BYTES
from dvc.slepian_wolf.requests import CODE, COUNT, FRAME, KIND, KINDS, LAST, PLANE, RUN, SLOT, START

ENDS, NEEDLESS, LONG, STANDING = 1, 2, 3, 4  # faults of syntax
(
    NO_PLANE, NO_FRAME, SECOND, OUT_OF_TURN, TOO_MANY, NO_CODE, TOO_MANY_JOINT, OTHER_PLANES,
    OTHER_COUNT, NEEDLESS_POSITIONS, NO_POSITIONS, NO_RUN,
) = range(1, 13)  # fmt: skip
CRC, PARITY, UNCODED, JOINT = (KINDS.index(kind) for kind in ("crc", "parity", "uncoded", "joint"))
HAS_POSITIONS, BEGINS = 4, 8  # bits of the first byte of a request beside its kind; the code comes above


class Rules(NamedTuple):
    """What requests of a configuration may be."""

    gop_length: int
    limits: NDArray[np.int64]  # most bits of a plane, by kinds
    crc_bits: int
    num_codes: int


class OpenFrames(NamedTuple):
    """What has been asked for of the frames of open groups of pictures, by slots and planes."""

    gops: NDArray[np.int64]  # first frame and number of frames of each open group
    requested: NDArray[np.int32]  # bits, by kinds
    awaited: NDArray[np.int32]  # bits that are asked for and have not come
    # of planes that name runs: how many these have; -1: in another's run, 0: in none
    num_planes: NDArray[np.int32]


@inlined_kernel
def _varint(data, at):
    """Read an integer as `dvc.bits.decode_varint` does; return it, what follows it, and what is wrong."""
    value = 0
    for count in range(MAX_VARINT_BYTES):
        if at + count >= data.size:
            return value, at, ENDS
        byte = np.int64(data[at + count])
        value |= (byte & 0x7F) << (7 * count)
        if byte <= 0x7F:
            return value, at + count + 1, NEEDLESS if byte == 0 and count > 0 else 0
    return value, at, LONG


@kernel
def _increasing(data, at, count, before, numbers, num_numbers):
    """Read increasing numbers; return what follows, how many there are now, and what is wrong."""
    for _ in range(count):
        step, at, fault = _varint(data, at)
        if fault or step == 0:
            return at, num_numbers, fault or STANDING
        before += step
        numbers[num_numbers] = before
        num_numbers += 1
    return at, num_numbers, 0


@kernel
def _run(data, at, plane, planes, num_planes, run):
    """Read a run; return what follows, how many planes of runs there are now, and what is wrong."""
    count, at, fault = _varint(data, at)
    if fault:
        return at, num_planes, fault
    planes[num_planes] = plane
    at, num_planes, fault = _increasing(data, at, count, plane, planes, num_planes + 1)
    if fault:
        return at, num_planes, fault
    size, at, fault = _varint(data, at)
    if fault or size > data.size - at:
        return at, num_planes, fault or ENDS
    run[0], run[1], run[2] = num_planes, at, at + size
    return at + size, num_planes, 0


@kernel
def parse_requests(data, rows, positions, planes, runs):
    """Read requests; return the number of them, of positions, bits wanted and runs, and what is wrong.

    `runs` (n, 3): where the planes of each end, and where its areas begin and end in the data.
    """
    at, n, m, frame, num_bits, num_planes, num_runs = 0, 0, 0, 0, 0, 0, 0
    while at < data.size:
        value, at, fault = _varint(data, at)
        if fault:
            return n, m, num_bits, num_runs, fault
        rows[n, KIND], rows[n, CODE] = value & 3, value >> 4
        num_positions, begins = value & HAS_POSITIONS, value & BEGINS
        for column in (FRAME, PLANE, COUNT):
            rows[n, column], at, fault = _varint(data, at)
            if fault:
                return n, m, num_bits, num_runs, fault
        frame += rows[n, FRAME]
        num_bits += rows[n, COUNT]
        rows[n, FRAME], rows[n, START], rows[n, SLOT] = frame, 0, 0
        if num_positions:
            num_positions = rows[n, COUNT]
            if rows[n, KIND] == JOINT:
                num_positions, at, fault = _varint(data, at)
                if fault:
                    return n, m, num_bits, num_runs, fault
        at, m, fault = _increasing(data, at, num_positions, -1, positions, m)
        rows[n, LAST], rows[n, RUN] = m, -1
        if begins and not fault:
            rows[n, RUN] = num_runs
            at, num_planes, fault = _run(data, at, rows[n, PLANE], planes, num_planes, runs[num_runs])
            num_runs += 1
        if fault:
            return n, m, num_bits, num_runs, fault
        n += 1
    return n, m, num_bits, num_runs, 0


@kernel
def slot_of(frame, gops, gop_length):
    """Return where a frame of an open group of pictures is held, -1: it is of none."""
    for k in range(gops.shape[0]):
        if gops[k, 0] <= frame < gops[k, 0] + gops[k, 1]:
            return k * gop_length + frame - gops[k, 0]
    return -1


@kernel
def _fault_of_positions(row, chosen, rules, num_planes, requested):
    """Say what is wrong with the positions of a request: given where, and only where, they mean something."""
    limit, limits, fault = 0, rules.limits, 0
    if row[KIND] == JOINT:
        limit = num_planes.size
        if row[COUNT] > rules.crc_bits:
            fault = TOO_MANY_JOINT
        elif chosen.size == 0 or chosen[0] != row[PLANE]:
            fault = OTHER_PLANES
    elif limits[JOINT] > 0 and row[KIND] == PARITY:
        limit = limits[PARITY] * num_planes[row[PLANE]] * (rules.num_codes - row[CODE])
        if chosen.size != row[COUNT]:
            fault = OTHER_COUNT
    if chosen.size and limit == 0:
        fault = NEEDLESS_POSITIONS
    before = -1
    for position in chosen:
        if position <= before or position >= limit:
            return fault or NO_POSITIONS
        # Runs that the message begins are all known by now; those of later requests have no bits yet.
        if row[KIND] == JOINT and position != row[PLANE] and not requested[position].any():
            return fault or NO_RUN
        before = position
    return fault


@inlined_kernel
def _limit(rules, kind, num_planes):
    """Return how many bits of a kind a run may have."""
    return rules.limits[kind] * (num_planes if kind in (PARITY, UNCODED) else 1)


@kernel
def enter_requests(rows, positions, frames, rules, in_turn):
    """Enter requests, and find where frames are held; return the first at fault, and its fault."""
    requested, awaited, num_planes = frames.requested, frames.awaited, frames.num_planes
    start = 0
    for n in range(rows.shape[0]):
        row = rows[n]
        plane, kind, code = row[PLANE], row[KIND], row[CODE]
        chosen = positions[start : row[LAST]]
        start = row[LAST]
        slot = slot_of(row[FRAME], frames.gops, rules.gop_length)
        row[SLOT] = slot
        fault = 0
        if not 0 <= plane < awaited.shape[1]:
            fault = NO_PLANE
        elif slot < 0:
            fault = NO_FRAME
        elif awaited[slot, plane]:
            fault = SECOND
        elif num_planes[slot, plane] <= 0:
            fault = NO_RUN
        if fault:
            return n, fault
        before = np.int64(requested[slot, plane, kind])
        if in_turn:
            row[START] = before
        if row[START] != before:
            fault = OUT_OF_TURN
        elif not 1 <= row[COUNT] <= _limit(rules, kind, num_planes[slot, plane]) - before:
            fault = TOO_MANY
        elif kind != UNCODED and not 0 <= code < rules.num_codes:
            fault = NO_CODE
        fault = fault or _fault_of_positions(row, chosen, rules, num_planes[slot], requested[slot])
        if fault:
            return n, fault
        requested[slot, plane, kind] += row[COUNT]
        awaited[slot, plane] = row[COUNT]
    return -1, 0


@kernel
def enter_answers(rows, awaited):
    """Strike out requests that are answered now; `awaited` as in `enter_requests`."""
    for n in range(rows.shape[0]):
        awaited[rows[n, SLOT], rows[n, PLANE]] = 0
