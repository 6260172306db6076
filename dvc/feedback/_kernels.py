"""Compiled loops over many requests, their syntax and what flow control says of them; validated by callers.

`rows` (n, 8) and `positions` (m,) are the columns of a `dvc.slepian_wolf.RequestTable`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.bits import MAX_VARINT_BYTES
from dvc.slepian_wolf.requests import CODE, COUNT, FRAME, KIND, KINDS, LAST, PLANE, SLOT, START

ENDS, NEEDLESS, LONG, STANDING = 1, 2, 3, 4  # faults of syntax
(
    NO_PLANE, NO_FRAME, SECOND, OUT_OF_TURN, TOO_MANY, NO_CODE, TOO_MANY_JOINT, OTHER_PLANES,
    OTHER_COUNT, NEEDLESS_POSITIONS, NO_POSITIONS,
) = range(1, 12)  # fmt: skip
CRC, PARITY, UNCODED, JOINT = (KINDS.index(kind) for kind in ("crc", "parity", "uncoded", "joint"))
HAS_POSITIONS = 4  # bit of the first byte of a request beside its kind; the code comes above


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
def parse_requests(data, rows, positions):
    """Read requests; return their number, that of positions and of bits wanted, and what is wrong."""
    at, n, m, frame, num_bits = 0, 0, 0, 0, 0
    while at < data.size:
        value, at, fault = _varint(data, at)
        if fault:
            return n, m, num_bits, fault
        rows[n, KIND], rows[n, CODE] = value & 3, value >> 3
        num_positions = value & HAS_POSITIONS
        for column in (FRAME, PLANE, COUNT):
            rows[n, column], at, fault = _varint(data, at)
            if fault:
                return n, m, num_bits, fault
        frame += rows[n, FRAME]
        num_bits += rows[n, COUNT]
        rows[n, FRAME], rows[n, START], rows[n, SLOT] = frame, 0, 0
        if num_positions:
            num_positions = rows[n, COUNT]
            if rows[n, KIND] == JOINT:
                num_positions, at, fault = _varint(data, at)
                if fault:
                    return n, m, num_bits, fault
        position = -1
        for _ in range(num_positions):
            step, at, fault = _varint(data, at)
            if fault:
                return n, m, num_bits, fault
            if step == 0:
                return n, m, num_bits, STANDING
            position += step
            positions[m] = position
            m += 1
        rows[n, LAST] = m
        n += 1
    return n, m, num_bits, 0


@kernel
def _slot_of(frame, gops, gop_length):
    """Return where a frame of an open group of pictures is held, -1: it is of none."""
    for k in range(gops.shape[0]):
        if gops[k, 0] <= frame < gops[k, 0] + gops[k, 1]:
            return k * gop_length + frame - gops[k, 0]
    return -1


@kernel
def _fault_of_positions(row, chosen, rules):
    """Say what is wrong with the positions of a request: given where, and only where, they mean something."""
    limit, limits = 0, rules.limits
    if row[KIND] == JOINT:
        limit = limits[JOINT] // rules.crc_bits
        if row[COUNT] > rules.crc_bits:
            return TOO_MANY_JOINT
        if chosen.size == 0 or chosen[0] != row[PLANE]:
            return OTHER_PLANES
    elif limits[JOINT] > 0 and row[KIND] == PARITY:
        limit = limits[PARITY] * (rules.num_codes - row[CODE])
        if chosen.size != row[COUNT]:
            return OTHER_COUNT
    if chosen.size and limit == 0:
        return NEEDLESS_POSITIONS
    before = -1
    for position in chosen:
        if position <= before or position >= limit:
            return NO_POSITIONS
        before = position
    return 0


@kernel
def enter_requests(rows, positions, frames, rules, in_turn):
    """Enter requests, and find where frames are held; return the first at fault, and its fault."""
    requested, awaited = frames.requested, frames.awaited
    start = 0
    for n in range(rows.shape[0]):
        row = rows[n]
        plane, kind, code = row[PLANE], row[KIND], row[CODE]
        chosen = positions[start : row[LAST]]
        start = row[LAST]
        slot = _slot_of(row[FRAME], frames.gops, rules.gop_length)
        row[SLOT] = slot
        fault = 0
        if not 0 <= plane < awaited.shape[1]:
            fault = NO_PLANE
        elif slot < 0:
            fault = NO_FRAME
        elif awaited[slot, plane]:
            fault = SECOND
        if fault:
            return n, fault
        before = np.int64(requested[slot, plane, kind])
        if in_turn:
            row[START] = before
        if row[START] != before:
            fault = OUT_OF_TURN
        elif not 1 <= row[COUNT] <= rules.limits[kind] - before:
            fault = TOO_MANY
        elif kind != UNCODED and not 0 <= code < rules.num_codes:
            fault = NO_CODE
        fault = fault or _fault_of_positions(row, chosen, rules)
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
