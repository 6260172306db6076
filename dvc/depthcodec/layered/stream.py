"""Streams of layers or sprites: a header that tells where each piece lies, and a stream of each piece.

Streams of pieces are those of `dvc.depthcodec.depth_image.stream`, masked, without what the header tells
already: magic, version and size. They are in the order of the pieces, so a stream that is cut gives the first
ones.
"""

import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dvc.bits import decode_varint, encode_varint
from dvc.depthcodec.container.header import MAGIC, MAX_PIXELS
from dvc.depthcodec.container.limits import Extent, check_extent
from dvc.depthcodec.depth_image import stream as depth_image
from dvc.depthcodec.depth_image.stream import DepthImageStream
from dvc.depthcodec.layered.pieces import Kind
from dvc.errors import BitstreamError, ConfigError, DvcError
from dvc.index_files import Entry
from dvc.multiview.camera_array import DisparityLabels
from dvc.stereo.layers.canvas import Canvas, Frame
from dvc.stereo.layers.canvas_files import read_canvas
from dvc.stereo.layers.layered_depth_image import MAX_LAYERS
from dvc.stereo.layers.sprites_folder import MAX_SPRITES

FORMAT_VERSION = 4
MAX_NAME_BYTES = 255
_FIXED = struct.Struct("<4sBB6HffHfHB")
_MATRIX = struct.Struct("<16f")
_SIZE = struct.Struct("<2H")
_CHECK_BYTES = 4
_SPRITES, _CALIBRATED = 1, 2
_SIZE_AT = 6
"""Where the size is in the stream of a piece; before it magic, version and flags."""


class Rectangle(NamedTuple):
    """Where a piece lies in the canvas."""

    left: int  # column and row of its first pixel
    top: int
    width: int  # its size; 0 of an empty layer
    height: int


@dataclass(frozen=True, eq=False)
class LayeredStream:
    """A stream."""

    canvas: Canvas  # where the pieces are
    kind: Kind  # what they are
    rectangles: tuple[Rectangle, ...]  # of all pieces
    # those that are there, the last one perhaps cut; None: an empty layer
    pieces: tuple[DepthImageStream | None, ...]
    num_header_bytes: int = 0  # of the header
    damage: str | None = None  # what is missing


def encode_stream(
    canvas: Canvas, kind: Kind, rectangles: Sequence[Rectangle], pieces: Sequence[DepthImageStream | None]
) -> bytes:
    """Return the bytes of a stream."""
    parts = [b"" if piece is None else piece_bytes(piece) for piece in pieces]
    header = encode_header(canvas, kind, rectangles, [len(part) for part in parts])
    return header + b"".join(parts)


def piece_bytes(piece: DepthImageStream) -> bytes:
    """Return the bytes of a piece."""
    data = depth_image.encode_stream(piece)
    return data[_SIZE_AT - 1 : _SIZE_AT] + data[_SIZE_AT + _SIZE.size :]


def encode_header(canvas: Canvas, kind: Kind, rectangles: Sequence[Rectangle], sizes: Sequence[int]) -> bytes:
    """Return the header of a stream."""
    name = canvas.reference.encode()
    if canvas.shape[0] * canvas.shape[1] > MAX_PIXELS or len(name) > MAX_NAME_BYTES:
        raise ConfigError(f"a canvas of at most {MAX_PIXELS} pixels is accepted, and a name of 255 bytes")
    matrix = canvas.world_from_rectified
    data = _FIXED.pack(
        MAGIC,
        FORMAT_VERSION,
        _SPRITES * (kind is Kind.SPRITES) | _CALIBRATED * (matrix is not None),
        *canvas.shape[::-1],
        *canvas.frame,
        *canvas.labels,
        canvas.resolution,
        canvas.num_cameras,
        len(name),
    )
    data += name + (b"" if matrix is None else _MATRIX.pack(*matrix.ravel()))
    data += encode_varint(len(rectangles))
    for rectangle, size in zip(rectangles, sizes, strict=True):
        data += b"".join(map(encode_varint, (*rectangle, size)))
    return data + zlib.crc32(data).to_bytes(_CHECK_BYTES, "little")


def decode_stream(data: bytes, max_mib: float | None = None) -> LayeredStream:
    """Read a stream, or the beginning of one."""
    canvas, kind, rectangles, sizes, start = _decode_header(data)
    size = canvas.shape[0] * canvas.shape[1]
    held = sum(rectangle.width * rectangle.height for rectangle in rectangles)
    held = (
        size * len(rectangles) if kind is Kind.LAYERS else held
    )  # layers are written as large as the canvas
    check_extent(Extent(size, held, size + held), len(data), max_mib)
    pieces: list[DepthImageStream | None] = []
    position, damage = start, None
    for number, (rectangle, size) in enumerate(zip(rectangles, sizes, strict=True), 1):
        part = data[position : position + size]
        position += size
        if not rectangle.width:
            pieces.append(None)
            continue
        prefix = MAGIC + bytes([depth_image.FORMAT_VERSION]) + part[:1]
        try:
            piece = depth_image.decode_stream(prefix + _SIZE.pack(*rectangle[2:]) + part[1:], math.inf)
            if not piece.masked or piece.picture is None:
                raise BitstreamError("no mask or no picture")
        except BitstreamError as err:
            cut = f"the stream ends after {len(data)} of {start + sum(sizes)} bytes"
            damage = cut if position > len(data) else f"piece {number} of {len(rectangles)}: {err}"
            break
        pieces.append(piece)
        if piece.damage is not None:
            damage = f"the stream ends after {len(data)} of {start + sum(sizes)} bytes"
            break
    if damage is None and position < len(data):
        damage = f"{len(data) - position} bytes follow"
    if not any(pieces) and any(rectangle.width for rectangle in rectangles):
        raise BitstreamError(f"not one piece is whole: {damage}")
    return LayeredStream(canvas, kind, tuple(rectangles), tuple(pieces), start, damage)


def _decode_header(data: bytes) -> tuple[Canvas, Kind, list[Rectangle], list[int], int]:
    """Read canvas, rectangles and sizes, and tell where the pieces begin."""
    if not data.startswith(MAGIC[: max(len(data), 1)]):
        raise BitstreamError("not a stream of texture and depth: it does not begin with DIBR")
    try:
        values = _FIXED.unpack_from(data)
        position = _FIXED.size
        name = data[position : position + values[-1]]
        position += values[-1]
        matrix = None
        if values[2] & _CALIBRATED:
            matrix = np.array(_MATRIX.unpack_from(data, position), np.float64).reshape(4, 4)
            position += _MATRIX.size
        number, position = decode_varint(data, position)
        kind = Kind(values[2] & _SPRITES)
        most = MAX_SPRITES if kind is Kind.SPRITES else MAX_LAYERS
        fields = []
        for _ in range(5 * min(number, most)):
            field, position = decode_varint(data, position)
            fields.append(field)
    except (struct.error, BitstreamError):
        raise BitstreamError(
            f"the stream ends within its header, or it is damaged, after {len(data)} bytes"
        ) from None
    check = data[position : position + _CHECK_BYTES]
    if number > most:
        raise BitstreamError("the header of the stream cannot have been written")
    if zlib.crc32(data[:position]).to_bytes(_CHECK_BYTES, "little") != check:
        raise BitstreamError("the header of the stream is cut or damaged")
    canvas = _canvas(values, name, matrix)
    rows = np.array(fields, object).reshape(-1, 5).tolist()
    rectangles = [Rectangle(*row[:4]) for row in rows]
    if values[1] != FORMAT_VERSION or values[2] > 3 or not _are_inside(rectangles, canvas):
        raise BitstreamError("the header of the stream cannot have been written")
    return canvas, kind, rectangles, [row[4] for row in rows], position + _CHECK_BYTES


def _are_inside(rectangles: Sequence[Rectangle], canvas: Canvas) -> bool:
    """Whether all rectangles are in the canvas, and not more than decoders want to hold."""
    height, width = canvas.shape
    inside = all(
        rectangle.left + rectangle.width <= width
        and rectangle.top + rectangle.height <= height
        and (rectangle.width > 0) == (rectangle.height > 0)
        for rectangle in rectangles
    )
    most = max(MAX_PIXELS, MAX_LAYERS * height * width)
    return inside and sum(rectangle.width * rectangle.height for rectangle in rectangles) <= most


def _canvas(values: tuple[int | float, ...], name: bytes, matrix: np.ndarray | None) -> Canvas:
    """The canvas of a header, if it can be one."""
    _, _, _, width, height, *rest = values
    frame, labels = Frame(*map(int, rest[:4])), DisparityLabels(float(rest[4]), float(rest[5]), int(rest[6]))
    try:
        reference = name.decode()
        canvas = Canvas(
            (int(height), int(width)), frame, labels, float(rest[7]), reference, int(rest[8]), matrix
        )
        entries = {
            "width": width, "height": height, "frame": frame._asdict(), "disparities": labels._asdict(),
            "resolution": canvas.resolution, "reference": reference, "num_cameras": canvas.num_cameras,
            "world_from_rectified": None if matrix is None else matrix.tolist(),
        }  # fmt: skip
        read_canvas(Entry(Path("header"), entries))
    except (DvcError, UnicodeDecodeError):
        raise BitstreamError("the header of the stream cannot have been written") from None
    if canvas.shape[0] * canvas.shape[1] > MAX_PIXELS:
        raise BitstreamError("the header of the stream cannot have been written")
    return canvas
