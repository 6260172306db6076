"""Streams of a depth map, with its picture or without: header, edges, and embedded code of both, interleaved.

The bytes of depth and picture alternate in proportion to their numbers, so a stream that is cut anywhere
after its edges has the same share of both.
"""

import math
import struct
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.dibr import dibr_streams as container
from dvc.dibr.depth_image.depth_scale import DepthScale, decode_extent, encode_extent
from dvc.dibr.limits import Extent, check_extent
from dvc.errors import BitstreamError, ConfigError
from dvc.images.chain_code import EdgeCode
from dvc.images.picture_header import PictureHeader

MAX_BYTES = 2**31
"""Of edges, of depth and of a picture."""
_FLAGS, _SIZE, _RANGE, _SCALE = (struct.Struct(f"<{fields}") for fields in ("B", "2H", "fH", "2f"))
_PICTURE, _ADAPTIVE_EDGES, _PICTURE_EDGES, _SCALED = 1, 2, 4, 8
_DEPTH_ORDER_SHIFT, _PICTURE_ORDER_SHIFT, _ORDER_MASK = 4, 6, 3
_MASKED = 0x80


@dataclass(frozen=True, eq=False)
class PlaneCode:
    """The embedded code of a depth map or of a picture."""

    header: PictureHeader  # what its decoder must know
    order: int  # of the extrapolation at edges, from 0 to 3
    data: bytes  # the code, or as much as there is of it


@dataclass(frozen=True, eq=False)
class DepthImageStream:
    """A stream."""

    shape: tuple[int, int]  # height and width
    scale: DepthScale  # of the numbers of the map
    edges: bytes  # their code; empty if there are none
    edge_code: EdgeCode  # how they are coded
    depth: PlaneCode  # the map
    picture: PlaneCode | None = None  # the picture, of as many levels and the same wavelet
    picture_edges: bool = False  # whether the picture's transform stops at the edges, too
    masked: bool = False  # whether the edges also tell where there is anything
    damage: str | None = None  # what is missing
    # of a stream that was read, whole or cut: what was neither edges nor code
    num_header_bytes: int | None = None


def check_map(shape: tuple[int, int], scale: DepthScale) -> None:
    """Refuse a map that no stream can hold."""
    container.check_shape(shape, "a map")
    if not _is_moderate(scale):
        raise ConfigError(f"numbers of a depth map: a range of at most {_MAX_FIELD:g} is accepted")


def encode_stream(stream: DepthImageStream) -> bytes:
    """Return the bytes of a stream."""
    data = container.begin(container.Body.DEPTH_IMAGE) + _encode_body(stream, _SIZE.pack(*stream.shape[::-1]))
    return data + container.checksum(data)


def encode_piece(stream: DepthImageStream) -> bytes:
    """Return the bytes of a piece of another stream, which tells its size; inverse of `decode_piece`."""
    data = _encode_body(stream, b"")
    return data + container.checksum(data)


def _encode_body(stream: DepthImageStream, size: bytes) -> bytes:
    depth, picture, scale = stream.depth, stream.picture, stream.scale
    is_scaled = (scale.factor, scale.offset) != (1.0, 0.0)
    flags = _PICTURE * (picture is not None) | _ADAPTIVE_EDGES * (stream.edge_code is EdgeCode.ADAPTIVE)
    flags |= _PICTURE_EDGES * stream.picture_edges | _SCALED * is_scaled | depth.order << _DEPTH_ORDER_SHIFT
    flags |= (picture.order if picture else 0) << _PICTURE_ORDER_SHIFT
    data = _FLAGS.pack(flags) + size + _RANGE.pack(scale.lowest, encode_extent(scale.extent))
    data += _SCALE.pack(scale.factor, scale.offset) if is_scaled else b""
    colour = picture is not None and picture.header.colour
    first, *rest = replace(depth.header, colour=colour).to_bytes()
    data += bytes([first | _MASKED * stream.masked, *rest])
    data += picture.header.to_bytes()[1:] if picture else b""
    parts = [stream.edges, depth.data, *([picture.data] if picture else [])]
    data += b"".join(encode_varint(len(part)) for part in parts) + stream.edges
    return data + _interleave(depth.data, picture.data if picture else b"")


def decode_stream(data: bytes, max_mib: float | None = None) -> DepthImageStream:
    """Read a stream, or the beginning of one."""
    reader = container.Reader.of_body(data, container.Body.DEPTH_IMAGE)
    (flags,), (width, height) = reader.fields(_FLAGS), reader.fields(_SIZE)
    if not 0 < height * width <= container.MAX_PIXELS:
        raise BitstreamError(_IMPOSSIBLE)
    size, has_picture = height * width, bool(flags & _PICTURE)
    found = _decode_body(reader, flags, (height, width))
    check_extent(Extent(size, size, size * (1 + has_picture)), len(data), max_mib)
    return found


def decode_piece(data: bytes, shape: tuple[int, int]) -> DepthImageStream:
    """Read a piece of another stream, or the beginning of one."""
    reader = container.Reader(data)
    (flags,) = reader.fields(_FLAGS)
    return _decode_body(reader, flags, shape)


def _decode_body(reader: container.Reader, flags: int, shape: tuple[int, int]) -> DepthImageStream:
    stream, (num_edges, num_depth, num_picture) = _decode_header(reader, flags, shape)
    data, start = reader.data, reader.position
    end = start + num_edges + num_depth + num_picture
    if len(data) < start + num_edges:
        raise BitstreamError(f"the stream ends within its edges, after {len(data)} bytes")
    if len(data) >= end + container.CHECK_BYTES:
        reader.bytes(end - start)
        reader.check("the stream is damaged")
        damage = f"{len(data) - reader.position} bytes follow" if len(data) > reader.position else None
    else:
        damage = f"the stream ends after {len(data)} of {end + container.CHECK_BYTES} bytes"
    edges = data[start : start + num_edges]
    depth_data, picture_data = _separate(data[start + num_edges : end], num_depth, num_picture)
    picture = replace(stream.picture, data=picture_data) if stream.picture else None
    depth = replace(stream.depth, data=depth_data)
    header = min(len(data), end + container.CHECK_BYTES) - num_edges - len(depth_data) - len(picture_data)
    return replace(stream, edges=edges, depth=depth, picture=picture, damage=damage, num_header_bytes=header)


def header_bytes(stream: DepthImageStream) -> int:
    """Return the bytes of a stream that are neither edges nor code."""
    if stream.num_header_bytes is not None:
        return stream.num_header_bytes
    parts = [stream.edges, stream.depth.data, stream.picture.data if stream.picture else b""]
    return len(encode_stream(stream)) - sum(map(len, parts))


def part_bytes(stream: DepthImageStream) -> dict[str, int]:
    """Return where the bytes of a stream go."""
    return {
        "header": header_bytes(stream),
        "edges": len(stream.edges),
        "depth": len(stream.depth.data),
        "image": len(stream.picture.data) if stream.picture else 0,
    }


def _decode_header(
    reader: container.Reader, flags: int, shape: tuple[int, int]
) -> tuple[DepthImageStream, tuple[int, int, int]]:
    """Read what precedes the edges: a stream without data, and their lengths."""
    lowest, extent = reader.fields(_RANGE)
    scale = DepthScale(
        lowest, decode_extent(extent), *(reader.fields(_SCALE) if flags & _SCALED else (1.0, 0.0))
    )
    first, *planes = reader.bytes(PictureHeader.SIZE)
    depth_header = PictureHeader.from_bytes(bytes([first & ~_MASKED, *planes]))
    has_picture, picture = bool(flags & _PICTURE), None
    orders = flags >> _DEPTH_ORDER_SHIFT & _ORDER_MASK, flags >> _PICTURE_ORDER_SHIFT & _ORDER_MASK
    if has_picture:
        header = PictureHeader.from_bytes(bytes([first & ~_MASKED]) + reader.bytes(PictureHeader.SIZE - 1))
        picture = PlaneCode(header, orders[1], b"")
    sizes = reader.varint(), reader.varint(), reader.varint() if has_picture else 0
    if not _is_moderate(scale) or max(sizes) > MAX_BYTES:
        raise BitstreamError(_IMPOSSIBLE)
    depth = PlaneCode(replace(depth_header, colour=False), orders[0], b"")
    code = EdgeCode(int(bool(flags & _ADAPTIVE_EDGES)))
    is_shared, is_masked = bool(flags & _PICTURE_EDGES), bool(first & _MASKED)
    return DepthImageStream(shape, scale, b"", code, depth, picture, is_shared, is_masked), sizes


_IMPOSSIBLE = "the header of the stream cannot have been written"
_MAX_FIELD = 2.0 * container.MAX_NUMBER  # of the numbers of a scale


def _is_moderate(scale: DepthScale) -> bool:
    numbers = scale.lowest, scale.extent, scale.factor, scale.offset
    are_small = all(math.isfinite(number) and abs(number) <= _MAX_FIELD for number in numbers)
    return are_small and scale.extent >= 0.0


def _is_depth(num_depth: int, num_picture: int, length: int) -> NDArray[np.bool_]:
    """Which of the first bytes of both are the depth's."""
    ends = np.arange(length + 1, dtype=np.int64) * num_depth
    return np.diff(ends // max(num_depth + num_picture, 1)) > 0


def _interleave(depth: bytes, picture: bytes) -> bytes:
    is_depth = _is_depth(len(depth), len(picture), len(depth) + len(picture))
    mixed = np.empty(len(is_depth), np.uint8)
    mixed[is_depth] = np.frombuffer(depth, np.uint8)
    mixed[~is_depth] = np.frombuffer(picture, np.uint8)
    return mixed.tobytes()


def _separate(mixed: bytes, num_depth: int, num_picture: int) -> tuple[bytes, bytes]:
    """Take apart as many of the bytes as there are."""
    is_depth = _is_depth(num_depth, num_picture, len(mixed))
    found = np.frombuffer(mixed, np.uint8)
    return found[is_depth].tobytes(), found[~is_depth].tobytes()
