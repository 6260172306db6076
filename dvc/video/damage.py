"""Damage that FFmpeg ignores: files that end too early, and FFV1 slices that fail their checksums."""

import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream

_EBML_ID = b"\x1a\x45\xdf\xa3"
_SEGMENT_ID = b"\x18\x53\x80\x67"
HEAD_BYTES = 4096

_SLICE_TRAILER_BYTES = 8  # 24 bits of size, 8 of status, 32 of checksum
_REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def file_extent(path: Path) -> tuple[int, bytes]:
    """Return the size of a file and its first `HEAD_BYTES`."""
    with path.open("rb") as file:
        return os.fstat(file.fileno()).st_size, file.read(HEAD_BYTES)


class DamageCheck:
    """Checks the packets of one video stream; `extent` returns size and first bytes of the source."""

    def __init__(
        self,
        extent: Callable[[], tuple[int, bytes]] | None,
        container: "InputContainer",
        stream: "VideoStream",
    ) -> None:
        self._extent = extent
        self._format = container.format.name
        self._declared_packets = stream.frames
        self._has_slice_checksums = stream.codec_context.name == "ffv1"
        self._num_packets = 0
        self._end_of_packets = 0

    def packet(self, packet: "av.Packet[VideoStream]") -> str | None:
        """Check one packet."""
        if packet.is_corrupt:
            return "the data fail their checks"
        if self._has_slice_checksums:
            slices = ffv1_slices(bytes(packet))
            valid = slices is not None and all(checksum_is_valid(s) for s in slices)
            if self._num_packets == 0 and not valid:
                # Checksums are optional: a first packet without a single valid one has none.
                self._has_slice_checksums = any(checksum_is_valid(s) for s in slices or ())
            if self._has_slice_checksums and not valid:
                return "the data fail their checks"
        self._num_packets += 1
        if packet.pos is not None:
            self._end_of_packets = packet.pos + packet.size
        return None

    def end(self) -> str | None:
        """Check that the file is complete."""
        if self._num_packets < self._declared_packets:
            return f"the file ends after {self._num_packets} of {self._declared_packets} frames"
        if self._extent is None:
            return None
        file_bytes, head = self._extent()
        if self._format == "yuv4mpegpipe" and 0 < self._end_of_packets < file_bytes:
            return "the file ends within a frame"
        declared_bytes = matroska_bytes(head) if "matroska" in self._format else None
        if declared_bytes is not None and file_bytes < declared_bytes:
            return f"the file ends after {file_bytes} of {declared_bytes} bytes"
        return None


def matroska_bytes(head: bytes) -> int | None:
    """Return the length of a Matroska file that its header states."""
    if not head.startswith(_EBML_ID):
        return None
    position, header_bytes = _ebml_size(head, len(_EBML_ID))
    if header_bytes is None or not head.startswith(_SEGMENT_ID, position + header_bytes):
        return None
    position, segment_bytes = _ebml_size(head, position + header_bytes + len(_SEGMENT_ID))
    return None if segment_bytes is None else position + segment_bytes


def _ebml_size(data: bytes, position: int) -> tuple[int, int | None]:
    """Return the offset of the content of an EBML element, and its size (RFC 8794, section 4)."""
    first = data[position] if position < len(data) else 0
    num_bytes = 9 - first.bit_length()
    if num_bytes > 8 or position + num_bytes > len(data):
        return position, None
    value_bits = 7 * num_bytes
    value = int.from_bytes(data[position : position + num_bytes], "big") & ((1 << value_bits) - 1)
    return position + num_bytes, None if value == (1 << value_bits) - 1 else value


def ffv1_slices(packet: bytes) -> list[bytes] | None:
    """Split a frame of FFV1 version 3 with checksums into its slices, trailers included."""
    slices = []
    end = len(packet)
    while end > 0:
        size = int.from_bytes(packet[end - 8 : end - 5], "big") + _SLICE_TRAILER_BYTES
        if size > end:
            return None
        slices.append(packet[end - size : end])
        end -= size
    return slices


def checksum_is_valid(data: bytes) -> bool:
    """Return whether data with a trailing FFV1 checksum are intact."""
    mirrored = data.translate(_REVERSED_BITS)
    return zlib.crc32(mirrored, 0xFFFFFFFF) == 0xFFFFFFFF
