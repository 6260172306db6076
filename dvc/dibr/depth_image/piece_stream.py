"""Streams of layers or sprites: a header with the rectangle of each piece, and a stream of each piece.

Streams of pieces are masked bodies of depth images without a size, which the header has. They have the order
of the pieces, so a stream that is cut gives the first ones.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvc.bits import encode_varint
from dvc.dibr.depth_image import depth_image_stream
from dvc.dibr.depth_image.depth_image_stream import DepthImageStream, decode_piece
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces
from dvc.dibr.dibr_streams import MAGIC, MAX_PIXELS, Body, FieldReader, check_extent, checksum
from dvc.errors import BitstreamError, ConfigError, DvcError
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import Viewpoint
from dvc.index_files import Entry
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.layer_folders import MAX_SPRITES, read_canvas
from dvc.layers.layered_depth_image import MAX_LAYERS
from dvc.layers.sprites import Sprite

MAX_NAME_BYTES = 255
_FIXED, _MATRIX = struct.Struct("<B6HffHfHB"), struct.Struct("<16f")
_SPRITES, _CALIBRATED = 1, 2
_IMPOSSIBLE = "the header of the stream cannot have been written"


@dataclass(frozen=True, eq=False)
class LayeredStream:
    """A stream."""

    canvas: Canvas
    kind: Kind
    rectangles: tuple[Frame, ...]  # rectangles of all pieces; empty for an empty layer
    # available pieces, the last one perhaps cut; None: an empty layer
    pieces: tuple[DepthImageStream | None, ...]
    num_header_bytes: int = 0
    damage: str | None = None  # description of the missing part


@dataclass(frozen=True, eq=False)
class DecodedPieces:
    """A decoded stream."""

    scene: Pieces
    damage: str | None  # description of the missing part

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of a view."""
        return self.scene.canvas.frame.height, self.scene.canvas.frame.width

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """The viewpoint of the reference view."""
        return (depth_image_stream.ORIGIN,)


def encode_stream(
    canvas: Canvas, kind: Kind, rectangles: Sequence[Frame], pieces: Sequence[DepthImageStream | None]
) -> bytes:
    """Return the bytes of a stream."""
    encode = depth_image_stream.encode_stream
    parts = [b"" if piece is None else encode(piece, is_piece=True) for piece in pieces]
    header = encode_header(canvas, kind, rectangles, [len(part) for part in parts])
    return header + b"".join(parts)


def encode_header(canvas: Canvas, kind: Kind, rectangles: Sequence[Frame], sizes: Sequence[int]) -> bytes:
    """Return the header of a stream."""
    name = canvas.reference.encode()
    if canvas.shape[0] * canvas.shape[1] > MAX_PIXELS or len(name) > MAX_NAME_BYTES:
        raise ConfigError(f"a canvas of at most {MAX_PIXELS} pixels is accepted, and a name of 255 bytes")
    matrix = canvas.world_from_rectified
    flags = _SPRITES * (kind is Kind.SPRITES) | _CALIBRATED * (matrix is not None)
    values = *canvas.shape[::-1], *canvas.frame, *canvas.labels, canvas.resolution, canvas.num_cameras
    data = MAGIC + bytes([Body.PIECES]) + _FIXED.pack(flags, *values, len(name))
    data += name + (b"" if matrix is None else _MATRIX.pack(*matrix.ravel()))
    data += encode_varint(len(rectangles))
    for rectangle, size in zip(rectangles, sizes, strict=True):
        data += b"".join(map(encode_varint, (*rectangle, size)))
    return data + checksum(data)


def decode_stream(data: bytes, max_mib: float | None = None) -> LayeredStream:
    """Read a stream, or the beginning of one."""
    canvas, kind, rectangles, sizes, start = _decode_header(data)
    num_pixels = canvas.shape[0] * canvas.shape[1]
    held = sum(rectangle.width * rectangle.height for rectangle in rectangles)
    if kind is Kind.LAYERS:  # folders of layers have pictures of the size of the canvas
        held = num_pixels * len(rectangles)
    check_extent(num_pixels, held, num_pixels + held, len(data), max_mib)
    pieces: list[DepthImageStream | None] = []
    position, damage = start, None
    cut = f"the stream ends after {len(data)} of {start + sum(sizes)} bytes"
    for number, (rectangle, size) in enumerate(zip(rectangles, sizes, strict=True), 1):
        part = data[position : position + size]
        position += size
        if not rectangle.width:
            pieces.append(None)
            continue
        try:
            piece = decode_piece(part, (rectangle.height, rectangle.width))
            if not piece.masked or piece.picture is None:
                raise BitstreamError("no mask or no picture")
            if piece.damage is not None and position <= len(data):
                raise BitstreamError(piece.damage)  # its lengths are wrong: the stream is not cut there
        except BitstreamError as err:
            damage = cut if position > len(data) else f"piece {number} of {len(rectangles)}: {err}"
            break
        pieces.append(piece)
        if piece.damage is not None:
            damage = cut
            break
    if damage is None and position < len(data):
        damage = f"{len(data) - position} bytes follow"
    if not any(pieces) and any(rectangle.width for rectangle in rectangles):
        raise BitstreamError(f"not one piece is whole: {damage}")
    return LayeredStream(canvas, kind, tuple(rectangles), tuple(pieces), start, damage)


def _decode_header(data: bytes) -> tuple[Canvas, Kind, list[Frame], list[int], int]:
    """Return canvas, kind, rectangles and sizes of the pieces, and the size of the header."""
    reader = FieldReader.of_body(data, Body.PIECES)
    flags, *values, name_bytes = reader.fields(_FIXED)
    name = reader.bytes(name_bytes)
    matrix = None
    if flags & _CALIBRATED:
        matrix = np.array(reader.fields(_MATRIX), np.float64).reshape(4, 4)
    kind, number = Kind(flags & _SPRITES), reader.varint()
    if number > (MAX_SPRITES if kind is Kind.SPRITES else MAX_LAYERS):
        raise BitstreamError(_IMPOSSIBLE)
    rows = [[reader.varint() for _ in range(5)] for _ in range(number)]
    reader.check("the header of the stream is cut or damaged")
    width, height, *frame = map(int, values[:6])
    labels = DisparityLabels(values[6], values[7], int(values[8]))
    try:
        canvas = Canvas(
            (height, width), Frame(*frame), labels, values[9], name.decode(), int(values[10]), matrix
        )
        entries = {
            "width": width, "height": height, "frame": canvas.frame._asdict(), "reference": canvas.reference,
            "disparities": labels._asdict(), "resolution": values[9], "num_cameras": canvas.num_cameras,
            "world_from_rectified": None if matrix is None else matrix.tolist(),
        }  # fmt: skip
        read_canvas(Entry(Path("header"), entries))  # checks them like those of an index file
    except (DvcError, UnicodeDecodeError):
        raise BitstreamError(_IMPOSSIBLE) from None
    rectangles = [Frame(*row[:4]) for row in rows]
    is_valid = height * width <= MAX_PIXELS and flags <= (_SPRITES | _CALIBRATED)
    for one in rectangles:
        is_valid &= one.left + one.width <= width and one.top + one.height <= height
        is_valid &= (one.width > 0) == (one.height > 0)
    area = sum(one.width * one.height for one in rectangles)
    if not is_valid or area > max(MAX_PIXELS, MAX_LAYERS * height * width):
        raise BitstreamError(_IMPOSSIBLE)
    return canvas, kind, rectangles, [row[4] for row in rows], reader.position


def decode(stream: LayeredStream) -> DecodedPieces:
    """Decode a stream.

    Parameters
    ----------
    stream : LayeredStream
        The stream, as it was read.

    Returns
    -------
    DecodedPieces
        Its pieces, up to the first that cannot have been written.

    Raises
    ------
    BitstreamError
        If that is the first one.
    """
    pieces: list[Sprite] = []
    damage = stream.damage
    for number, (rectangle, piece) in enumerate(zip(stream.rectangles, stream.pieces, strict=False), 1):
        if piece is None:
            nothing = np.zeros((0, 0, 3), np.uint8)
            pieces.append(Sprite(0, 0, nothing[..., 0] > 0, nothing, nothing[..., 0].astype(np.float32)))
            continue
        try:
            decoded = depth_image_stream.decode(piece)
        except BitstreamError as err:
            damage = f"piece {number} of {len(stream.rectangles)}: {err}"
            break
        mask, picture = decoded.mask, decoded.picture
        assert mask is not None
        assert picture is not None
        colour = np.broadcast_to(picture.reshape(*mask.shape, -1), (*mask.shape, 3)) * mask[..., None]
        disparity = np.where(mask, decoded.disparity, 0.0).astype(np.float32)
        pieces.append(Sprite(rectangle.left, rectangle.top, mask, colour, disparity))
    if not any(piece.mask.any() for piece in pieces) and damage is not None:
        raise BitstreamError(f"not one piece can be decoded: {damage}")
    return DecodedPieces(Pieces(stream.canvas, stream.kind, tuple(pieces)), damage)
