"""The frame of all `.dibr` streams: magic, kind of the body, checksums, a reader of fields, and limits.

The modules that code a body describe it: `view_stream` views, `depth_image.depth_image_stream` a depth map
with or without its picture, `depth_image.piece_stream` layers and sprites.
"""

import struct
import zlib
from enum import IntEnum
from typing import Any

from dvc.errors import BitstreamError, ConfigError

MAGIC = b"DIBR"
MAX_PIXELS = 2**24
MAX_SIDE = 2**16 - 1
"""Largest height and width: they take two bytes."""
MAX_NUMBER = 1e12
"""Largest number that describes a camera or a disparity; anything beyond is not a measurement."""
CHECK_BYTES = 4

MAX_LAYERS = 32
"""Most quality layers of a stream."""
MAX_MIB = 2048
"""Default limit of the memory for decoding and rendering."""
FREE_PIXELS = 1024 * 768
"""Pixels, over all quality layers, that a stream of any length may have."""
PIXELS_PER_BYTE = 1024
"""Further pixels for each byte: no picture worth decoding takes fewer bits."""
_BYTES_PER_HELD, _BYTES_PER_SHOWN = 50, 140  # measured in colour: 84 in four references, 190 in one, rendered

CODEC_NUMBERS = {"l": 0, "s": 1, "quadtree": 2, "blocks": 3}
"""Numbers of disparity codecs in streams, by name."""
BUILT_IN_CODECS = tuple(CODEC_NUMBERS)
DEFAULT_CODEC = BUILT_IN_CODECS[0]


class Body(IntEnum):
    """Kinds of streams; the version byte after the magic."""

    VIEWS = 1
    DEPTH_IMAGE = 3
    PIECES = 5


def check_shape(shape: tuple[int, int], label: str) -> None:
    """Refuse pictures that no stream can hold."""
    height, width = shape
    if not (min(shape) > 0 and max(shape) <= MAX_SIDE and height * width <= MAX_PIXELS):
        raise ConfigError(
            f"{label} of {width}x{height}: sides of 1 to {MAX_SIDE} and up to {MAX_PIXELS} pixels "
            "are accepted"
        )


def check_extent(shown: int, held: int, decoded: int, num_bytes: int, max_mib: float | None) -> None:
    """Refuse a stream that exceeds the memory limit, or has too many pixels for its bytes.

    Pixels are those of a rendered view, of all pictures and disparity maps in memory at once, and of all
    pictures over all quality layers.
    """
    memory = shown * _BYTES_PER_SHOWN + held * _BYTES_PER_HELD
    if memory > (MAX_MIB if max_mib is None else max_mib) * 2**20:
        raise BitstreamError(
            f"decoding takes about {memory / 2**20:.0f} MiB, more than {max_mib or MAX_MIB:g}: "
            "--max-memory raises the limit"
        )
    if max_mib is None and decoded > FREE_PIXELS + PIXELS_PER_BYTE * num_bytes:
        raise BitstreamError(
            f"{num_bytes} bytes are too few for {decoded} pixels: --max-memory {MAX_MIB} decodes them"
        )


def body_of(data: bytes) -> Body:
    """Return the kind of a stream."""
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
    """Return the CRC-32 of data."""
    return zlib.crc32(data).to_bytes(CHECK_BYTES, "little")


class FieldReader:
    """Reads fields from a position in a stream on; refuses those that are cut off."""

    def __init__(self, data: bytes, position: int = 0, section: str = "its header") -> None:
        self.data, self.start, self.position, self._section = data, position, position, section

    @classmethod
    def of_body(cls, data: bytes, body: Body) -> "FieldReader":
        """Return a reader of a body; checksums also cover the bytes before it."""
        if body_of(data) is not body:
            raise BitstreamError(f"the stream is of version {body_of(data)}; {body} is accepted")
        reader = cls(data)
        reader.position = len(MAGIC) + 1
        return reader

    def bytes(self, size: int) -> bytes:
        """Return the next bytes."""
        if size > len(self.data) - self.position:
            raise BitstreamError(f"the stream ends within {self._section}, after {len(self.data)} bytes")
        self.position += size
        return self.data[self.position - size : self.position]

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return the next fields of a layout."""
        return layout.unpack(self.bytes(layout.size))

    def varint(self) -> int:
        """Return the next number of variable length."""
        from dvc.bits import decode_varint  # imports numpy

        try:
            number, self.position = decode_varint(self.data, self.position)
        except BitstreamError:
            self.bytes(len(self.data) + 1)
            raise
        return number

    def check(self, damage: str) -> None:
        """Compare the bytes since the start with the checksum that follows them."""
        expected = checksum(self.data[self.start : self.position])
        if self.bytes(CHECK_BYTES) != expected:
            raise BitstreamError(damage)
