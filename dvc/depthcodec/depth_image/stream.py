"""Streams of a depth map, with its picture or without: header, edges, and embedded code of both, interleaved.

The bytes of depth and picture alternate in proportion to their numbers, so a stream that is cut anywhere
after its edges has the same share of both.
"""

import math
import struct
import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.bits import decode_varint, encode_varint
from dvc.depthcodec.container.header import MAGIC, MAX_NUMBER, MAX_PIXELS
from dvc.depthcodec.container.limits import Extent, check_extent
from dvc.depthcodec.depth_image.depth_scale import DepthScale, decode_extent, encode_extent
from dvc.errors import BitstreamError
from dvc.imagecodec.edges.chain_code import EdgeCode
from dvc.imagecodec.header import PictureHeader

FORMAT_VERSION = 3
MAX_BYTES = 2**31
"""Of edges, of depth and of a picture."""
_FIXED = struct.Struct("<4sBBHHfH")
_SCALE = struct.Struct("<2f")
_CHECK_BYTES = 4
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


def encode_stream(stream: DepthImageStream) -> bytes:
    """Return the bytes of a stream."""
    depth, picture, scale = stream.depth, stream.picture, stream.scale
    is_scaled = (scale.factor, scale.offset) != (1.0, 0.0)
    flags = _PICTURE * (picture is not None) | _ADAPTIVE_EDGES * (stream.edge_code is EdgeCode.ADAPTIVE)
    flags |= _PICTURE_EDGES * stream.picture_edges | _SCALED * is_scaled | depth.order << _DEPTH_ORDER_SHIFT
    flags |= (picture.order if picture else 0) << _PICTURE_ORDER_SHIFT
    extent = encode_extent(scale.extent)
    data = _FIXED.pack(MAGIC, FORMAT_VERSION, flags, *stream.shape[::-1], scale.lowest, extent)
    data += _SCALE.pack(scale.factor, scale.offset) if is_scaled else b""
    colour = picture is not None and picture.header.colour
    first, *rest = replace(depth.header, colour=colour).to_bytes()
    data += bytes([first | _MASKED * stream.masked, *rest])
    data += picture.header.to_bytes()[1:] if picture else b""
    parts = [stream.edges, depth.data, *([picture.data] if picture else [])]
    data += b"".join(encode_varint(len(part)) for part in parts) + stream.edges
    data += _interleave(depth.data, picture.data if picture else b"")
    return data + zlib.crc32(data).to_bytes(_CHECK_BYTES, "little")


def decode_stream(data: bytes, max_mib: float | None = None) -> DepthImageStream:
    """Read a stream, or the beginning of one."""
    stream, sizes, position = _decode_header(data)
    size = stream.shape[0] * stream.shape[1]
    check_extent(Extent(size, size, size * (1 + (stream.picture is not None))), len(data), max_mib)
    num_edges, num_depth, num_picture = sizes
    end = position + num_edges + num_depth + num_picture
    if len(data) < position + num_edges:
        raise BitstreamError(f"the stream ends within its edges, after {len(data)} bytes")
    if len(data) >= end + _CHECK_BYTES:
        if zlib.crc32(data[:end]).to_bytes(_CHECK_BYTES, "little") != data[end : end + _CHECK_BYTES]:
            raise BitstreamError("the stream is damaged")
        damage = f"{len(data) - end - _CHECK_BYTES} bytes follow" if len(data) > end + _CHECK_BYTES else None
    else:
        damage = f"the stream ends after {len(data)} of {end + _CHECK_BYTES} bytes"
    edges = data[position : position + num_edges]
    depth_data, picture_data = _separate(data[position + num_edges : end], num_depth, num_picture)
    picture = replace(stream.picture, data=picture_data) if stream.picture else None
    depth = replace(stream.depth, data=depth_data)
    header = min(len(data), end + _CHECK_BYTES) - num_edges - len(depth_data) - len(picture_data)
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


def _decode_header(data: bytes) -> tuple[DepthImageStream, tuple[int, int, int], int]:
    """Read what precedes the edges: a stream without data, their lengths, and where they begin."""
    cut = f"the stream ends within its header, after {len(data)} bytes"
    if not data.startswith(MAGIC[: max(len(data), 1)]):
        raise BitstreamError("not a stream of texture and depth: it does not begin with DIBR")
    if len(data) < _FIXED.size:
        raise BitstreamError(cut)
    _, version, flags, width, height, lowest, extent = _FIXED.unpack_from(data)
    if version != FORMAT_VERSION:
        raise BitstreamError(f"the stream is of version {version}; {FORMAT_VERSION} is accepted")
    position = _FIXED.size + _SCALE.size * bool(flags & _SCALED)
    if len(data) < position:
        raise BitstreamError(cut)
    numbers = _SCALE.unpack_from(data, _FIXED.size) if flags & _SCALED else (1.0, 0.0)
    scale = DepthScale(lowest, decode_extent(extent), *numbers)
    if not (0 < height * width <= MAX_PIXELS and _is_moderate(scale)):
        raise BitstreamError("the header of the stream cannot have been written")
    has_picture = bool(flags & _PICTURE)
    planes = data[position : position + PictureHeader.SIZE]
    position += PictureHeader.SIZE
    more = data[position : position + 2] if has_picture else b""
    position += 2 * has_picture
    if len(data) < position:
        raise BitstreamError(cut)
    first = planes[0] & ~_MASKED
    depth_header = replace(PictureHeader.from_bytes(bytes([first]) + planes[1:]), colour=False)
    picture_header = PictureHeader.from_bytes(bytes([first]) + more) if has_picture else None
    sizes = [0, 0, 0]
    for number in range(2 + has_picture):
        sizes[number], position = _decode_size(data, position, cut)
    orders = flags >> _DEPTH_ORDER_SHIFT & _ORDER_MASK, flags >> _PICTURE_ORDER_SHIFT & _ORDER_MASK
    stream = DepthImageStream(
        (height, width),
        scale,
        b"",
        EdgeCode(int(bool(flags & _ADAPTIVE_EDGES))),
        PlaneCode(depth_header, orders[0], b""),
        PlaneCode(picture_header, orders[1], b"") if picture_header else None,
        bool(flags & _PICTURE_EDGES),
        bool(planes[0] & _MASKED),
    )
    return stream, (sizes[0], sizes[1], sizes[2]), position


def _decode_size(data: bytes, position: int, cut: str) -> tuple[int, int]:
    try:
        size, position = decode_varint(data, position)
    except BitstreamError:
        raise BitstreamError(cut) from None
    if size > MAX_BYTES:
        raise BitstreamError("the header of the stream cannot have been written")
    return size, position


def _is_moderate(scale: DepthScale) -> bool:
    numbers = scale.lowest, scale.extent, scale.factor, scale.offset
    are_small = all(math.isfinite(number) and abs(number) <= 2.0 * MAX_NUMBER for number in numbers)
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
