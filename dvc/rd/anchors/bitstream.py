"""Units of elementary streams: which bytes are pictures, and which only describe them."""

from collections.abc import Callable
from itertools import pairwise
from typing import Final

from dvc.errors import BitstreamError

_START_CODE = b"\x00\x00\x01"
_MAX_LEB128_BYTES = 8
# OBU_FRAME_HEADER, OBU_TILE_GROUP, OBU_FRAME, OBU_REDUNDANT_FRAME_HEADER, OBU_TILE_LIST ([AV1] 6.2.2).
_AV1_PICTURE_TYPES = frozenset({3, 4, 6, 7, 8})
_H264_SEI = 6
_H265_SEI = frozenset({39, 40})


def nal_units(stream: bytes) -> list[bytes]:
    """Split a byte stream ([H264] annex B) into NAL units that keep their start codes."""
    starts = []
    position = stream.find(_START_CODE)
    while position >= 0:
        starts.append(position - (position > 0 and stream[position - 1] == 0))
        position = stream.find(_START_CODE, position + len(_START_CODE))
    return [stream[start:end] for start, end in pairwise([*starts, len(stream)])]


def _h264_type(unit: bytes) -> int:
    """Return `nal_unit_type` of H.264, 0 to 31."""
    return _first_byte(unit) & 31


def _h265_type(unit: bytes) -> int:
    """Return `nal_unit_type` of H.265, 0 to 63."""
    return _first_byte(unit) >> 1 & 63


def without_overhead(stream: bytes, file_format: str, known: bytes = b"") -> bytes:
    """Leave out what no decoder needs: messages (x264 writes its options there), and parameter sets again."""
    if file_format == "obu":
        return stream
    type_of, messages = (_h264_type, {_H264_SEI}) if file_format == "h264" else (_h265_type, _H265_SEI)
    bodies = {unit.lstrip(b"\x00") for unit in nal_units(known)}
    return b"".join(
        unit
        for unit in nal_units(stream)
        if type_of(unit) not in messages and unit.lstrip(b"\x00") not in bodies
    )


def picture_bytes(packet: bytes, file_format: str) -> int:
    """Count the bytes of a packet that belong to its picture."""
    return _COUNTERS[file_format](packet)


def _first_byte(unit: bytes) -> int:
    position = unit.find(_START_CODE) + len(_START_CODE)
    return unit[position] if position < len(unit) else 0


def _h264_picture_bytes(packet: bytes) -> int:
    return sum(len(unit) for unit in nal_units(packet) if 1 <= _h264_type(unit) <= 5)


def _h265_picture_bytes(packet: bytes) -> int:
    return sum(len(unit) for unit in nal_units(packet) if _h265_type(unit) < 32)


def _av1_picture_bytes(packet: bytes) -> int:
    """Walk over open bitstream units of the low-overhead format ([AV1] 5.3)."""
    count = position = 0
    while position < len(packet):
        start, header = position, packet[position]
        position += 2 if header & 4 else 1
        if header & 2:
            size, position = _leb128(packet, position)
        else:
            size = len(packet) - position
        position += size
        if position > len(packet):
            raise BitstreamError("AV1: a unit is longer than its packet")
        if header >> 3 & 15 in _AV1_PICTURE_TYPES:
            count += position - start
    return count


def _leb128(data: bytes, position: int) -> tuple[int, int]:
    value = 0
    for index in range(_MAX_LEB128_BYTES):
        if position + index >= len(data):
            break
        byte = data[position + index]
        value |= (byte & 127) << 7 * index
        if byte < 128:
            return value, position + index + 1
    raise BitstreamError("AV1: a unit without a valid length")


_COUNTERS: Final[dict[str, Callable[[bytes], int]]] = {
    "h264": _h264_picture_bytes,
    "hevc": _h265_picture_bytes,
    "obu": _av1_picture_bytes,
}
