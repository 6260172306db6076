"""Compiled loops over many requests: which parity they need, and the bits that they want.

`rows` (n, 8) and `positions` (m,) are those of a `RequestTable`, whose slots say where frames are
held; callers have validated them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.slepian_wolf.crc import joint_check_of_words
from dvc.slepian_wolf.requests import CODE, COUNT, KIND, KINDS, LAST, PLANE, SLOT, START

_CRC, _PARITY, _JOINT = (KINDS.index(kind) for kind in ("crc", "parity", "joint"))


class HeldFrames(NamedTuple):
    """Frames of which bits may be asked for, by slots; parity stands in places of its own."""

    num_planes: NDArray[np.int64]
    words: NDArray[np.uint64]
    checks: NDArray[np.uint64]
    places: NDArray[np.int64]  # of the parity of each row of words, by codes; -1: none
    last_use: NDArray[np.int64]  # the pass in which parity was last asked for
    owners: NDArray[np.int64]  # slot, row and code of each place; -1: none
    parity: NDArray[np.uint64]
    polynomial: int  # of the check bits
    patience: int  # passes since a frame was last asked for, from which on its parity gives way to others


@kernel
def _place_to_take(first, frames, now):
    """Return a place for parity: from `first` on, below which all are in use, one free or long out of use."""
    owners, last_use = frames.owners, frames.last_use
    for place in range(first, owners.shape[0]):
        slot = owners[place, 0]
        if slot < 0 or last_use[slot] < now - frames.patience:
            return place
    oldest = 0
    for place in range(owners.shape[0]):
        if last_use[owners[place, 0]] < last_use[owners[oldest, 0]]:
            oldest = place
    return oldest if last_use[owners[oldest, 0]] < now else -1


@kernel
def _missing_parity(rows, positions, first_row, frames, now, missing):
    """List the parity that requests from `first_row` on need and that is not known; return how much."""
    num_planes, places, owners, num_bits = (
        frames.num_planes,
        frames.places,
        frames.owners,
        frames.words.shape[2],
    )
    count, place = 0, -1
    start = rows[first_row - 1, LAST] if first_row > 0 else 0
    for n in range(first_row, rows.shape[0]):
        slot, plane, first = rows[n, SLOT], rows[n, PLANE], rows[n, CODE]
        chosen = positions[start : rows[n, LAST]]
        start = rows[n, LAST]
        if plane >= num_planes[slot] or (rows[n, KIND] == _JOINT and chosen[-1] >= num_planes[slot]):
            return count, n
        if rows[n, KIND] == _PARITY:
            frames.last_use[slot] = now
            row = plane // 64
            last = first + chosen[-1] // num_bits if chosen.size else first
            for code in range(first, last + 1):
                if places[slot, row, code] >= 0:
                    continue
                place = _place_to_take(place + 1, frames, now)
                if place < 0:
                    return count, n
                if owners[place, 0] >= 0:
                    places[owners[place, 0], owners[place, 1], owners[place, 2]] = -1
                places[slot, row, code] = place
                owners[place, 0], owners[place, 1], owners[place, 2] = slot, row, code
                missing[count, :3], missing[count, 3] = owners[place], place
                count += 1
    return count, rows.shape[0]


@inlined_kernel
def _append(bit, num_written, packed):
    """Write one more bit, from the top bit of each byte on."""
    if num_written % 8 == 0:
        packed[num_written // 8] = 0
    packed[num_written // 8] |= np.uint8(bit << np.uint64(7 - num_written % 8))
    return num_written + 1


@kernel
def answer_requests(rows, positions, first_row, last_row, frames, written, packed):
    """Write the bits that requests before `last_row` want behind those `written`; return their number."""
    places, parity = frames.places, frames.parity
    one, num_bits = np.uint64(1), frames.words.shape[2]
    begin = rows[first_row - 1, LAST] if first_row > 0 else 0
    for n in range(first_row, last_row):
        slot, plane, kind, code = rows[n, SLOT], rows[n, PLANE], rows[n, KIND], rows[n, CODE]
        start, count = rows[n, START], rows[n, COUNT]
        chosen = positions[begin : rows[n, LAST]]
        begin = rows[n, LAST]
        shift, row = np.uint64(63 - plane % 64), plane // 64
        section = frames.words[slot, row]
        if kind == _CRC:
            section = frames.checks[slot, row]
        elif kind == _PARITY:
            section = parity[places[slot, row, code]]
        if kind == _JOINT:
            register = joint_check_of_words(frames.checks[slot], chosen, frames.polynomial)
            for k in range(count):
                written = _append(register[k], written, packed)
        elif chosen.size:
            first = 0
            for position in chosen:
                while position - first >= num_bits:
                    first, code = first + num_bits, code + 1
                    section = parity[places[slot, row, code]]
                written = _append((section[position - first] >> shift) & one, written, packed)
        else:
            for k in range(start, start + count):
                written = _append((section[k] >> shift) & one, written, packed)
    return written


@kernel
def answer_known(rows, positions, first_row, frames, now, missing, written, packed):
    """Answer requests from `first_row` on; where parity is missing, list it instead, and write nothing."""
    count, last_row = _missing_parity(rows, positions, first_row, frames, now, missing)
    if count == 0:
        written = answer_requests(rows, positions, first_row, last_row, frames, written, packed)
    return count, last_row, written
