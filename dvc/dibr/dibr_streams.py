"""The container of all streams: magic, what the body is, checksums, and how fields are read.

Bodies are described beside their decoders: views in `prediction.stream`, a depth map or a picture with one
in `depth_image.stream`, layers and sprites in `layered.stream`.
"""

import struct
import zlib
from enum import IntEnum
from typing import Any

from dvc.bits import decode_varint
from dvc.errors import BitstreamError, ConfigError

MAGIC = b"DIBR"
MAX_PIXELS = 2**24
MAX_SIDE = 2**16 - 1
"""Heights and widths are told in two bytes."""
MAX_NUMBER = 1e12
"""Of what describes cameras and disparities; anything beyond is no measurement."""
CHECK_BYTES = 4


def check_shape(shape: tuple[int, int], what: str) -> None:
    """Refuse pictures that no stream can hold."""
    height, width = shape
    if not (min(shape) > 0 and max(shape) <= MAX_SIDE and height * width <= MAX_PIXELS):
        raise ConfigError(
            f"{what} of {width}x{height}: sides of 1 to {MAX_SIDE} and up to {MAX_PIXELS} pixels are accepted"
        )


class Body(IntEnum):
    """What a stream holds, and in which layout."""

    VIEWS = 1
    DEPTH_IMAGE = 3
    PIECES = 5


def begin(body: Body) -> bytes:
    """Return what streams begin with."""
    return MAGIC + bytes([body])


def body_of(data: bytes) -> Body:
    """Return what a stream holds."""
    if not data.startswith(MAGIC[: max(len(data), 1)]):
        raise BitstreamError("not a stream of texture and depth: it does not begin with DIBR")
    if len(data) <= len(MAGIC):
        raise BitstreamError(f"the stream ends within its header, after {len(data)} bytes")
    if data[len(MAGIC)] not in list(Body):
        raise BitstreamError(
            f"the stream is of version {data[len(MAGIC)]}; {', '.join(map(str, Body))} are accepted"
        )
    return Body(data[len(MAGIC)])


def checksum(data: bytes) -> bytes:
    """Return the CRC-32 of some bytes."""
    return zlib.crc32(data).to_bytes(CHECK_BYTES, "little")


class Reader:
    """Reads fields from the beginning of a stream, or from the middle; refuses those that are cut off."""

    def __init__(self, data: bytes, position: int = 0, place: str = "its header") -> None:
        self.data, self.start, self.position, self._place = data, position, position, place

    @classmethod
    def of_body(cls, data: bytes, body: Body) -> "Reader":
        """Return a reader of the body, whose checksums are those of what precedes it, too."""
        if body_of(data) is not body:
            raise BitstreamError(f"the stream is of version {body_of(data)}; {body} is accepted")
        reader = cls(data)
        reader.position = len(begin(body))
        return reader

    def bytes(self, size: int) -> bytes:
        """Return the next bytes."""
        if size > len(self.data) - self.position:
            raise BitstreamError(f"the stream ends within {self._place}, after {len(self.data)} bytes")
        self.position += size
        return self.data[self.position - size : self.position]

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return the next fields of a layout."""
        return layout.unpack(self.bytes(layout.size))

    def varint(self) -> int:
        """Return the next number of variable length."""
        try:
            number, self.position = decode_varint(self.data, self.position)
        except BitstreamError:
            self.bytes(len(self.data) + 1)
            raise
        return number

    def check(self, damage: str) -> None:
        """Compare all that was read with the checksum that follows."""
        found = checksum(self.data[self.start : self.position])
        if self.bytes(CHECK_BYTES) != found:
            raise BitstreamError(damage)
