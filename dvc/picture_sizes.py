"""Sizes that picture files state, read before anything of them is decoded."""

import struct
from collections.abc import Iterator
from contextlib import suppress

_STATING = (*range(0xC0, 0xC4), *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0))
"""Markers of JPEG that a size follows."""
_BARE = (0x01, *range(0xD0, 0xDA))
"""Markers of JPEG without a length."""


def stated_size(content: bytes) -> tuple[int, int] | None:
    """Return width and height as a PNG, JPEG, TIFF or WebP file states them; None where none is found."""
    with suppress(struct.error, ValueError, OverflowError):
        if content.startswith(b"\x89PNG\r\n\x1a\n"):
            return struct.unpack_from(">II", content, 16)
        if content.startswith(b"\xff\xd8"):
            return _jpeg_size(content)
        if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            tags = dict(_tiff_tags(content))
            return (tags[256], tags[257]) if {256, 257} <= tags.keys() else None
        if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
            return _webp_size(content)
    return None


def _jpeg_size(content: bytes) -> tuple[int, int]:
    at = 2
    while True:
        at = content.index(b"\xff", at)
        (marker,) = struct.unpack_from("B", content, at + 1)
        if marker in _STATING:
            height, width = struct.unpack_from(">HH", content, at + 5)
            return width, height
        if marker in (0x00, 0xFF):
            at += 1
        elif marker in _BARE:
            at += 2
        else:
            at += 2 + struct.unpack_from(">H", content, at + 2)[0]


def _tiff_tags(content: bytes) -> Iterator[tuple[int, int]]:
    """Yield numbers and values of the entries of the first picture that hold one whole number."""
    order = "<" if content[:1] == b"I" else ">"
    is_big = b"+" in content[:4]
    at = struct.unpack_from(f"{order}Q" if is_big else f"{order}I", content, 8 if is_big else 4)[0]
    count = struct.unpack_from(f"{order}Q" if is_big else f"{order}H", content, at)[0]
    at += 8 if is_big else 2
    for _ in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", content, at)
        if form := {3: "H", 4: "I", 16: "Q"}.get(kind):
            yield tag, struct.unpack_from(order + form, content, at + (12 if is_big else 8))[0]
        at += 20 if is_big else 12


def _webp_size(content: bytes) -> tuple[int, int] | None:
    kind = content[12:16]
    if kind == b"VP8X":
        width, height = (int.from_bytes(content[at : at + 3], "little") + 1 for at in (24, 27))
        return width, height
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", content, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None
