"""Depth maps as files, and their streams, with or without a picture: header, edges, embedded code of both.

The bytes of depth and picture alternate in proportion to their numbers, so a stream that is cut anywhere
after its edges has the same share of both.
"""

import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.dibr import dibr_streams
from dvc.dibr.dibr_streams import CHECK_BYTES, MAGIC, MAX_NUMBER, MAX_PIXELS, Body, FieldReader
from dvc.dibr.view_rendering import PictureAndDisparity
from dvc.errors import BitstreamError, ConfigError, DvcError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import Viewpoint
from dvc.images import chain_code, picture_codec
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_maps import EdgeMaps, Mask, border
from dvc.images.picture_codec import DecodedPicture, PictureHeader
from dvc.picture_files import largest_level, read_levels, read_pfm

Plane = NDArray[np.float64]

NUM_LEVELS = 1020.0
"""Levels of the coder over the range of a map; finer than 8 bits, so that these are exact."""
_MIDDLE = 128.0
_HALF_BITS = 16
INPAINT_RADIUS = 3.0
"""Radius in pixels of the neighbourhood that fills holes."""
MAX_BYTES = 2**31
"""Most bytes of edges, of depth and of a picture."""
ORIGIN = LatticePosition(0.0, 0.0)
"""Viewpoint of the picture."""
_FLAGS, _SIZE, _RANGE, _SCALE = (struct.Struct(f"<{fields}") for fields in ("B", "2H", "fH", "2f"))
_PICTURE, _ADAPTIVE_EDGES, _PICTURE_EDGES, _SCALED = 1, 2, 4, 8
_DEPTH_ORDER_SHIFT, _PICTURE_ORDER_SHIFT, _ORDER_MASK = 4, 6, 3
_MASKED = 0x80
_IMPOSSIBLE = "the header of the stream cannot have been written"
_MAX_FIELD = 2.0 * MAX_NUMBER
"""Largest number of a scale."""


@dataclass(frozen=True)
class DepthScale:
    """Meaning of the numbers of a map."""

    lowest: float  # least number, of single precision
    # range of numbers, rounded up to the upper half of single precision; 0: all are the lowest
    extent: float
    # disparity, in pixels per unit of m, is `factor` times the number plus `offset`; single precision
    factor: float = 1.0
    offset: float = 0.0

    @classmethod
    def of(cls, depth: Plane, factor: float = 1.0, offset: float = 0.0) -> Self:
        """Return the scale of a map."""
        if not np.all(np.abs(depth) <= MAX_NUMBER):
            raise ConfigError(f"numbers of a depth map: at most {MAX_NUMBER:g} is accepted")
        if not (np.float32(factor) and max(abs(factor), abs(offset)) <= MAX_NUMBER):
            raise ConfigError(
                f"disparity of {factor:g} times a number plus {offset:g}: "
                f"neither may be more than {MAX_NUMBER:g}, nor the factor zero"
            )
        least, largest = float(depth.min()), float(depth.max())
        lowest = np.float32(least)
        if largest > least and lowest > least:
            lowest = np.nextafter(lowest, np.float32(-np.inf))
        extent = 0.0
        if largest > least:  # the least number of half of single precision that is not below
            single = np.float32(largest - float(lowest))
            if float(single) < largest - float(lowest):
                single = np.nextafter(single, np.float32(np.inf))
            extent = decode_extent(-(-int(single.view(np.uint32)) >> _HALF_BITS))
        return cls(float(lowest), extent, float(np.float32(factor)), float(np.float32(offset)))

    @property
    def unit(self) -> float:
        """Size of a level of the coder in numbers of the map."""
        return self.extent / NUM_LEVELS

    def levels(self, depth: Plane) -> Plane:
        """Return the levels of a map; the inverse of `depth`."""
        if not self.extent:
            return np.full(depth.shape, _MIDDLE)
        return (depth - self.lowest) / self.unit - 0.5 * NUM_LEVELS + _MIDDLE

    def depth(self, levels: Plane) -> Plane:
        """Return the map of levels, within its range."""
        return self.lowest + np.clip(levels - _MIDDLE + 0.5 * NUM_LEVELS, 0.0, NUM_LEVELS) * self.unit

    def disparity(self, depth: Plane) -> Plane:
        """Return the disparities of a map."""
        return self.factor * depth + self.offset


def encode_extent(extent: float) -> int:
    """Return the upper half of the single-precision bits of an extent; the inverse of `decode_extent`."""
    return int(np.float32(extent).view(np.uint32)) >> _HALF_BITS


def decode_extent(bits: int) -> float:
    """Return the extent of 16 bits."""
    return float(np.uint32(bits << _HALF_BITS).view(np.float32))


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A depth map that was read."""

    depth: Plane  # numbers of the file; holes are filled
    known: NDArray[np.bool_]  # False in holes
    largest: float  # largest number of the file format: 255, 65535, or infinite

    def scale(self, factor: float = 1.0, near_far: tuple[float, float] | None = None) -> DepthScale:
        """Return the meaning of the numbers; `near_far` are the depths of the largest number and of 0."""
        if near_far is None:
            return DepthScale.of(self.depth, factor)
        if not np.isfinite(self.largest):
            raise ConfigError("--near-far requires a map of 8 or 16 bits")
        near, far = 1.0 / near_far[0], 1.0 / near_far[1]
        return DepthScale.of(self.depth, factor * (near - far) / self.largest, factor * far)


def read_depth_map(path: str | Path, hole: float | None = None) -> DepthMap:
    """Read a depth map."""
    if Path(path).suffix.lower() == ".pfm":
        depth, largest = read_pfm(path).astype(np.float64), np.inf
    else:
        depth, largest = read_levels(path), float(largest_level(path))
    known = np.isfinite(depth)
    if hole is not None:
        known &= depth != hole
    if not known.any():
        raise DvcError(f"{path}: the depth map is empty")
    return DepthMap(filled(np.where(known, depth, np.nan)), known, largest)


def default_hole(path: str | Path) -> float | None:
    """Return the number of holes in maps of disparities: 0 in pictures."""
    return None if Path(path).suffix.lower() == ".pfm" else 0.0


def filled(depth: Plane) -> Plane:
    """Continue a map into its holes."""
    known = np.isfinite(depth)
    if known.all():
        return depth
    middle = float(np.median(depth[known]))
    plane = np.where(known, depth, middle).astype(np.float32)
    inpainted = cv2.inpaint(plane, (~known).astype(np.uint8), INPAINT_RADIUS, cv2.INPAINT_TELEA)
    low, high = float(depth[known].min()), float(depth[known].max())
    # inpainting near the largest number of single precision may overflow
    finite = np.nan_to_num(inpainted.astype(np.float64), nan=middle)
    return np.where(known, depth, np.clip(finite, low, high))


@dataclass(frozen=True, eq=False)
class PlaneCode:
    """The embedded code of a depth map or of a picture."""

    header: PictureHeader
    order: int  # order of the extrapolation at edges, from 0 to 3
    data: bytes  # the code, or its available part


@dataclass(frozen=True, eq=False)
class DepthImageStream:
    """A stream."""

    shape: tuple[int, int]  # height and width
    scale: DepthScale  # meaning of the numbers of the map
    edges: bytes  # code of the edges; empty if there are none
    edge_code: EdgeCode
    depth: PlaneCode  # the map
    picture: PlaneCode | None = None  # the picture, with the levels and the wavelet of the map
    picture_edges: bool = False  # the transform of the picture also stops at the edges
    masked: bool = False  # the code of the edges includes a mask
    damage: str | None = None  # description of the missing part
    # bytes that are neither edges nor code, of a stream that was read, whole or cut
    num_header_bytes: int | None = None

    @property
    def part_bytes(self) -> dict[str, int]:
        """Bytes of `header` (with lengths and checksum), `edges`, `depth` and `image`."""
        parts = {
            "edges": len(self.edges),
            "depth": len(self.depth.data),
            "image": len(self.picture.data) if self.picture else 0,
        }
        header = self.num_header_bytes
        if header is None:
            header = len(encode_stream(self)) - sum(parts.values())
        return {"header": header, **parts}

    def decoded_edges(self) -> tuple[EdgeMaps, Mask | None]:
        """Return the edges of a stream, and its mask."""
        if self.masked:
            return chain_code.decode_masked(self.edges, self.shape, self.edge_code)
        if not self.edges:
            return EdgeMaps.none(self.shape), None
        return chain_code.decode(self.edges, self.shape, self.edge_code), None


def check_map(shape: tuple[int, int], scale: DepthScale) -> None:
    """Refuse a map that no stream can hold."""
    dibr_streams.check_shape(shape, "a map")
    if not _is_moderate(scale):
        raise ConfigError(f"numbers of a depth map: a range of at most {_MAX_FIELD:g} is accepted")


def _is_moderate(scale: DepthScale) -> bool:
    numbers = scale.lowest, scale.extent, scale.factor, scale.offset
    are_small = all(math.isfinite(number) and abs(number) <= _MAX_FIELD for number in numbers)
    return are_small and scale.extent >= 0.0


def encode_stream(stream: DepthImageStream, is_piece: bool = False) -> bytes:
    """Return the bytes of a stream, or of a piece of another stream, which has its size."""
    depth, picture, scale = stream.depth, stream.picture, stream.scale
    is_scaled = (scale.factor, scale.offset) != (1.0, 0.0)
    flags = _PICTURE * (picture is not None) | _ADAPTIVE_EDGES * (stream.edge_code is EdgeCode.ADAPTIVE)
    flags |= _PICTURE_EDGES * stream.picture_edges | _SCALED * is_scaled | depth.order << _DEPTH_ORDER_SHIFT
    flags |= (picture.order if picture else 0) << _PICTURE_ORDER_SHIFT
    data = b"" if is_piece else MAGIC + bytes([Body.DEPTH_IMAGE])
    data += _FLAGS.pack(flags) + (b"" if is_piece else _SIZE.pack(*stream.shape[::-1]))
    data += _RANGE.pack(scale.lowest, encode_extent(scale.extent))
    data += _SCALE.pack(scale.factor, scale.offset) if is_scaled else b""
    colour = picture is not None and picture.header.colour
    first, *rest = replace(depth.header, colour=colour).to_bytes()
    data += bytes([first | _MASKED * stream.masked, *rest])
    data += picture.header.to_bytes()[1:] if picture else b""
    parts = [stream.edges, depth.data, *([picture.data] if picture else [])]
    data += b"".join(encode_varint(len(part)) for part in parts) + stream.edges
    is_depth = _is_depth(len(depth.data), sum(map(len, parts[2:])), sum(map(len, parts[1:])))
    mixed = np.empty(len(is_depth), np.uint8)
    mixed[is_depth] = np.frombuffer(depth.data, np.uint8)
    mixed[~is_depth] = np.frombuffer(b"".join(parts[2:]), np.uint8)
    data += mixed.tobytes()
    return data + dibr_streams.checksum(data)


def decode_stream(data: bytes, max_mib: float | None = None) -> DepthImageStream:
    """Read a stream, or the beginning of one."""
    reader = FieldReader.of_body(data, Body.DEPTH_IMAGE)
    (flags,), (width, height) = reader.fields(_FLAGS), reader.fields(_SIZE)
    size = height * width
    if not 0 < size <= MAX_PIXELS:
        raise BitstreamError(_IMPOSSIBLE)
    stream = _decode_body(reader, flags, (height, width))
    dibr_streams.check_extent(size, size, size * (1 + bool(flags & _PICTURE)), len(data), max_mib)
    return stream


def decode_piece(data: bytes, shape: tuple[int, int]) -> DepthImageStream:
    """Read a piece of another stream, or the beginning of one."""
    reader = FieldReader(data)
    (flags,) = reader.fields(_FLAGS)
    return _decode_body(reader, flags, shape)


def _decode_body(reader: FieldReader, flags: int, shape: tuple[int, int]) -> DepthImageStream:
    lowest, extent = reader.fields(_RANGE)
    meaning = reader.fields(_SCALE) if flags & _SCALED else (1.0, 0.0)
    scale = DepthScale(lowest, decode_extent(extent), *meaning)
    first, *planes = reader.bytes(PictureHeader.SIZE)
    depth_header = PictureHeader.from_bytes(bytes([first & ~_MASKED, *planes]))
    picture_header = None
    if flags & _PICTURE:
        rest = reader.bytes(PictureHeader.SIZE - 1)
        picture_header = PictureHeader.from_bytes(bytes([first & ~_MASKED]) + rest)
    num_edges, num_depth = reader.varint(), reader.varint()
    num_picture = reader.varint() if picture_header else 0
    if not _is_moderate(scale) or max(num_edges, num_depth, num_picture) > MAX_BYTES:
        raise BitstreamError(_IMPOSSIBLE)
    data, start = reader.data, reader.position
    end = start + num_edges + num_depth + num_picture
    if len(data) < start + num_edges:
        raise BitstreamError(f"the stream ends within its edges, after {len(data)} bytes")
    if len(data) >= end + CHECK_BYTES:
        reader.bytes(end - start)
        reader.check("the stream is damaged")
        damage = f"{len(data) - reader.position} bytes follow" if len(data) > reader.position else None
    else:
        damage = f"the stream ends after {len(data)} of {end + CHECK_BYTES} bytes"
    mixed = np.frombuffer(data[start + num_edges : end], np.uint8)
    is_depth = _is_depth(num_depth, num_picture, len(mixed))
    depth_data, picture_data = mixed[is_depth].tobytes(), mixed[~is_depth].tobytes()
    depth_order, picture_order = (
        flags >> shift & _ORDER_MASK for shift in (_DEPTH_ORDER_SHIFT, _PICTURE_ORDER_SHIFT)
    )
    edges = data[start : start + num_edges], EdgeCode(int(bool(flags & _ADAPTIVE_EDGES)))
    depth = PlaneCode(replace(depth_header, colour=False), depth_order, depth_data)
    picture = PlaneCode(picture_header, picture_order, picture_data) if picture_header else None
    shared, masked = bool(flags & _PICTURE_EDGES), bool(first & _MASKED)
    num_header_bytes = min(len(data), end + CHECK_BYTES) - num_edges - len(mixed)
    return DepthImageStream(shape, scale, *edges, depth, picture, shared, masked, damage, num_header_bytes)


def _is_depth(num_depth: int, num_picture: int, length: int) -> NDArray[np.bool_]:
    """Return which of the first interleaved bytes belong to the depth."""
    ends = np.arange(length + 1, dtype=np.int64) * num_depth
    return np.diff(ends // max(num_depth + num_picture, 1)) > 0


@dataclass(frozen=True, eq=False)
class DecodedDepthImage:
    """A decoded stream."""

    stream: DepthImageStream
    depth: Plane  # the map, in its own numbers; (H, W)
    picture: NDArray[np.uint8] | None  # gray, or red, green and blue; (H, W) or (H, W, 3)
    edges: EdgeMaps  # edges of the full resolution
    resolution: int  # number of times that the sides of map and picture are halved
    mask: Mask | None = None  # False outside a piece; None: no mask; (h, w)
    viewpoints: tuple[Viewpoint, ...] = (ORIGIN,)  # viewpoint of the picture
    step: float = 0.0  # distance of neighbouring disparities: they are continuous

    @property
    def disparity(self) -> Plane:
        """Disparity, in pixels of the map per unit of m and n."""
        return self.stream.scale.disparity(self.depth) / 2.0**self.resolution

    @property
    def pairs(self) -> tuple[PictureAndDisparity, ...]:
        """The picture with its disparities; empty without a picture."""
        if self.picture is None:
            return ()
        return (PictureAndDisparity(self.picture, self.disparity, ORIGIN),)

    @property
    def damage(self) -> str | None:
        """Description of the missing part of the stream."""
        return self.stream.damage


def decode(stream: DepthImageStream, resolution: int = 0) -> DecodedDepthImage:
    """Decode a stream.

    Parameters
    ----------
    stream : DepthImageStream
        The stream, as it was read.
    resolution : int, optional
        Number of times that the sides of map and picture are halved.

    Returns
    -------
    DecodedDepthImage
        Map and picture.

    Raises
    ------
    BitstreamError
        If the stream cannot have been written.
    ConfigError
        If the stream has fewer resolutions.
    """
    num_levels = stream.depth.header.num_levels
    if not 0 <= resolution <= num_levels:
        raise ConfigError(f"resolution {resolution}: 0 to {num_levels} are accepted")
    edges, mask = stream.decoded_edges()
    picture = None
    if stream.picture:  # first, as it takes more memory
        stops = edges if stream.picture_edges else None if mask is None else border(mask)
        picture = decode_plane(stream.picture, stops, stream.shape, resolution, mask).picture()
    levels = decode_plane(stream.depth, edges, stream.shape, resolution, mask).planes[0]
    coarse = None if mask is None else mask[:: 2**resolution, :: 2**resolution]
    return DecodedDepthImage(stream, stream.scale.depth(levels), picture, edges, resolution, coarse)


def decode_plane(
    code: PlaneCode,
    edges: EdgeMaps | None,
    shape: tuple[int, int],
    resolution: int = 0,
    mask: Mask | None = None,
) -> DecodedPicture:
    """Decode a map, as levels, or a picture."""
    if mask is None and edges is not None and not edges.count():
        edges = None
    return picture_codec.decode(code.header, code.data, shape, resolution, edges, code.order, mask)
