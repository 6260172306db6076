"""Compiled loops that parse requests and check them against the open groups; validated by callers.

`rows` (n, 9) and `positions` (m,) are the columns of a `dvc.slepian_wolf.RequestTable`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.bits import MAX_VARINT_BYTES
from dvc.slepian_wolf.requests import (
    BEGUN,
    CODE,
    COUNT,
    FRAME,
    KIND,
    KINDS,
    LAST,
    MAX_RUN_BITS,
    RUN,
    SLOT,
    START,
)  # fmt: skip

TRUNCATED, OVERLONG, TOO_LARGE, NOT_INCREASING = 1, 2, 3, 4  # faults of syntax
(
    NO_RUN, NO_FRAME, UNANSWERED, TOO_MANY, NO_CODE, TOO_MANY_JOINT, WRONG_FIRST_RUN,
    WRONG_COUNT, NEEDLESS_POSITIONS, BAD_POSITIONS,
) = range(1, 11)  # fmt: skip
CRC, PARITY, UNCODED, JOINT = (KINDS.index(kind) for kind in ("crc", "parity", "uncoded", "joint"))
HAS_POSITIONS, BEGINS = 4, 8  # flags in the first byte of a request, between kind and code


class Rules(NamedTuple):
    """Bounds of the requests of a configuration."""

    gop_length: int
    limits: NDArray[np.int64]  # largest number of bits of a plane, by kind
    crc_bits: int
    num_codes: int


class OpenFrames(NamedTuple):
    """Requests for frames of open groups of pictures, by slot and run."""

    gops: NDArray[np.int64]  # first frame and number of frames of each open group
    requested: NDArray[np.int32]  # number of bits, by kind
    awaited: NDArray[np.int32]  # number of bits of unanswered requests
    num_planes: NDArray[np.int32]  # number of planes of a run; 0 if it has not begun


@inlined_kernel
def _varint(data, at):
    """Read an integer as `dvc.bits.decode_varint` does; return it, the position after it, and the fault."""
    value = 0
    for count in range(MAX_VARINT_BYTES):
        if at + count >= data.size:
            return value, at, TRUNCATED
        byte = np.int64(data[at + count])
        value |= (byte & 0x7F) << (7 * count)
        if byte <= 0x7F:
            return value, at + count + 1, OVERLONG if byte == 0 and count > 0 else 0
    return value, at, TOO_LARGE


@kernel
def _increasing(data, at, count, before, numbers, num_numbers):
    """Read increasing numbers; return the position after them, their new count, and the fault."""
    for _ in range(count):
        step, at, fault = _varint(data, at)
        if fault or step == 0:
            return at, num_numbers, fault or NOT_INCREASING
        before += step
        numbers[num_numbers] = before
        num_numbers += 1
    return at, num_numbers, 0


@kernel
def _run(data, at, planes, num_planes, parts, num_parts, number):
    """Read a run; return the position after it, the new counts of planes and parts, and the fault."""
    count, at, fault = _varint(data, at)
    offset = -1
    for _ in range(0 if fault else count):
        step, at, fault = _varint(data, at)
        if fault or step == 0:
            return at, num_planes, num_parts, fault or NOT_INCREASING
        offset += step
        count_planes, at, fault = _varint(data, at)
        if fault:
            return at, num_planes, num_parts, fault
        at, num_planes, fault = _increasing(data, at, count_planes, -1, planes, num_planes)
        if fault:
            return at, num_planes, num_parts, fault
        size, at, fault = _varint(data, at)
        if fault or size > data.size - at:
            return at, num_planes, num_parts, fault or TRUNCATED
        part = parts[num_parts]
        part[0], part[1], part[2], part[3], part[4] = number, offset, num_planes, at, at + size
        at += size
        num_parts += 1
    return at, num_planes, num_parts, fault


@kernel
def parse_requests(data, rows, positions, planes, parts):
    """Read requests; return the counts of requests, positions, bits, runs and parts, and the fault.

    `parts` (n, 5): run, offset of the frame, end of its planes, start and end of its areas in the data.
    """
    at, n, m, frame, num_bits, num_planes, num_runs, num_parts = 0, 0, 0, 0, 0, 0, 0, 0
    fault = 0
    while at < data.size and not fault:
        value, at, fault = _varint(data, at)
        rows[n, KIND], rows[n, CODE] = value & 3, value >> 4
        num_positions, begins = value & HAS_POSITIONS, value & BEGINS
        for column in (FRAME, RUN, COUNT):
            if not fault:
                rows[n, column], at, fault = _varint(data, at)
        if fault:
            break
        frame += rows[n, FRAME]
        num_bits += rows[n, COUNT]
        rows[n, FRAME], rows[n, START], rows[n, SLOT] = frame, 0, 0
        if num_positions:
            num_positions = rows[n, COUNT]
            if rows[n, KIND] == JOINT:
                num_positions, at, fault = _varint(data, at)
        if not fault:
            at, m, fault = _increasing(data, at, num_positions, -1, positions, m)
        rows[n, LAST], rows[n, BEGUN] = m, -1
        if begins and not fault:
            rows[n, BEGUN] = num_runs
            at, num_planes, num_parts, fault = _run(data, at, planes, num_planes, parts, num_parts, num_runs)
            num_runs += 1
        n += 1
    return n, m, num_bits, num_runs, num_parts, fault


@kernel
def slot_of(frame, gops, gop_length):
    """Return the slot of a frame of an open group of pictures, -1 if it is in none."""
    for k in range(gops.shape[0]):
        if gops[k, 0] <= frame < gops[k, 0] + gops[k, 1]:
            return k * gop_length + frame - gops[k, 0]
    return -1


@inlined_kernel
def _limit(rules, kind, num_planes):
    """Return the largest number of bits of a kind that may be requested of a run."""
    if kind in (PARITY, UNCODED):
        return min(rules.limits[kind] * num_planes, MAX_RUN_BITS)
    return rules.limits[kind]


@kernel
def _fault_of_positions(row, chosen, rules, num_planes, requested):
    """Return the fault of the positions of a request, which only some requests have."""
    limit, limits, fault = 0, rules.limits, 0
    if row[KIND] == JOINT:
        limit = num_planes.size
        if row[COUNT] > rules.crc_bits:
            fault = TOO_MANY_JOINT
        elif chosen.size == 0 or chosen[0] != row[RUN]:
            fault = WRONG_FIRST_RUN
    elif limits[JOINT] > 0 and row[KIND] == PARITY:
        limit = _limit(rules, PARITY, num_planes[row[RUN]]) * (rules.num_codes - row[CODE])
        if chosen.size != row[COUNT]:
            fault = WRONG_COUNT
    if chosen.size and limit == 0:
        fault = NEEDLESS_POSITIONS
    before = -1
    for position in chosen:
        if position <= before or position >= limit:
            return fault or BAD_POSITIONS
        # All runs of the message have begun here, but later requests have not been entered.
        if row[KIND] == JOINT and position != row[RUN] and not requested[position].any():
            return fault or NO_RUN
        before = position
    return fault


@kernel
def enter_requests(rows, positions, frames, rules):
    """Enter requests, fill in their slots and starts; return the first bad request and its fault."""
    requested, awaited, num_planes = frames.requested, frames.awaited, frames.num_planes
    start = 0
    for n in range(rows.shape[0]):
        row = rows[n]
        run, kind, code = row[RUN], row[KIND], row[CODE]
        chosen = positions[start : row[LAST]]
        start = row[LAST]
        slot = slot_of(row[FRAME], frames.gops, rules.gop_length)
        row[SLOT] = slot
        fault = 0
        if slot < 0:
            fault = NO_FRAME
        elif not 0 <= run < awaited.shape[1] or num_planes[slot, run] == 0:
            fault = NO_RUN
        elif awaited[slot, run]:
            fault = UNANSWERED
        if fault:
            return n, fault
        before = np.int64(requested[slot, run, kind])
        row[START] = before
        if not 1 <= row[COUNT] <= _limit(rules, kind, num_planes[slot, run]) - before:
            fault = TOO_MANY
        elif kind != UNCODED and not 0 <= code < rules.num_codes:
            fault = NO_CODE
        fault = fault or _fault_of_positions(row, chosen, rules, num_planes[slot], requested[slot])
        if fault:
            return n, fault
        requested[slot, run, kind] += row[COUNT]
        awaited[slot, run] = row[COUNT]
    return -1, 0
