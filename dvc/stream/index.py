"""Syntax of the end of a stream: the number of frames and, in the buffered form, where every GOP lies."""

from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate

from dvc.bits import decode_varint, encode_varint
from dvc.errors import BitstreamError
from dvc.stream.records import CRC_BYTES, MAX_GOPS, Form, framed_size

SIZE_BYTES = 4
TRAILER_BYTES = SIZE_BYTES + CRC_BYTES
"""Last bytes of a buffered stream: size of the end record, then its checksum."""


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """One GOP record."""

    offset: int  # offset of the record in the stream, in bytes
    size: int  # size of the record, in bytes
    num_frames: int  # that it adds


@dataclass(frozen=True)
class StreamIndex:
    """All GOP records of a stream."""

    num_frames: int
    entries: tuple[IndexEntry, ...]

    def first_frame(self, gop: int) -> int:
        """Return the number of the first frame that a GOP adds.

        Parameters
        ----------
        gop : int
            Number of the GOP, from 0.

        Returns
        -------
        int
            Number of the frame, from 0 in order of display.
        """
        return sum(entry.num_frames for entry in self.entries[:gop])

    def gop_of(self, frame: int) -> int:
        """Return which GOP adds a frame.

        Parameters
        ----------
        frame : int
            Number of the frame, from 0 in order of display.

        Returns
        -------
        int
            Number of the GOP, from 0.

        Raises
        ------
        ValueError
            If the frame does not exist.
        """
        ends = list(accumulate(entry.num_frames for entry in self.entries))
        if not 0 <= frame < self.num_frames:
            raise ValueError(f"`frame` must be from 0 to {self.num_frames - 1}, got {frame}")
        return bisect_right(ends, frame)


def encode_end(index: StreamIndex, form: Form) -> bytes:
    """Write the payload of the end record; inverse of `decode_end`."""
    payload = encode_varint(index.num_frames)
    if form is not Form.BUFFERED:
        return payload
    parts = [payload, encode_varint(len(index.entries))]
    for entry in index.entries:
        parts += [encode_varint(entry.size), encode_varint(entry.num_frames)]
    payload = b"".join(parts)
    return payload + framed_size(len(payload) + SIZE_BYTES).to_bytes(SIZE_BYTES, "little")


def decode_end(
    payload: bytes, form: Form, first_offset: int, max_gops: int = MAX_GOPS
) -> tuple[int, tuple[IndexEntry, ...] | None]:
    """Read the payload of the end record; inverse of `encode_end`."""
    num_frames, position = decode_varint(payload, 0)
    entries = None
    if form is Form.BUFFERED:
        entries, position = _decode_entries(payload, position, first_offset, max_gops)
        if sum(entry.num_frames for entry in entries) != num_frames:
            raise BitstreamError("the index does not add up to the number of frames")
        if payload[position : position + SIZE_BYTES] != framed_size(len(payload)).to_bytes(
            SIZE_BYTES, "little"
        ):
            raise BitstreamError("the size of the record is not restated")
        position += SIZE_BYTES
    if position != len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes are left over")
    return num_frames, entries


def _decode_entries(
    payload: bytes, position: int, offset: int, max_gops: int
) -> tuple[tuple[IndexEntry, ...], int]:
    count, position = decode_varint(payload, position)
    if count > max_gops:
        raise BitstreamError(f"an index of {count} groups of pictures, at most {max_gops} are possible")
    entries = []
    for _ in range(count):
        size, position = decode_varint(payload, position)
        num_frames, position = decode_varint(payload, position)
        entries.append(IndexEntry(offset, size, num_frames))
        offset += size
    return tuple(entries), position
