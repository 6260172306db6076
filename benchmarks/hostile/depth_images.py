"""Streams of depth maps, with pictures or without: good ones, their mutations, and their decoder."""

import zlib
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.hostile.mutations import mutate, nearest
from dvc.dibr.depth_image.depth_image_encoder import (
    DepthImage,
    DepthOptions,
    PictureOptions,
    code_edges,
    encode_to_size,
)
from dvc.dibr.depth_image.depth_image_stream import DepthImageStream, decode, decode_stream, encode_stream
from dvc.dibr.depth_image.depth_scale import DepthScale
from dvc.dibr.view_rendering import picture_of, render
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import LatticePosition
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_extraction import edges_of_jumps
from dvc.images.edge_maps import EdgeMaps

_HEIGHT, _WIDTH = 37, 50
_CHECK_BYTES = 4
_MAX_BYTES = 600


@cache
def good_streams() -> tuple[bytes, ...]:
    """Encode a small map, and pictures with it, in all ways."""
    rng = np.random.default_rng(5)
    depth = _depth(rng)
    edges = edges_of_jumps(depth, 4.0)
    coloured = rng.integers(0, 256, (_HEIGHT, _WIDTH, 3), np.uint8)
    pictures = None, coloured[:, :, 0], coloured
    streams = []
    for number in range(8):
        scale = DepthScale.of(depth, *((0.25, -1.0) if number % 2 else (1.0, 0.0)))
        image = DepthImage(depth, scale, pictures[number % 3])
        chosen = code_edges(
            EdgeMaps.none(edges.shape) if number == 6 else edges,
            EdgeCode.FIXED if number % 4 == 1 else EdgeCode.ADAPTIVE,
        )
        options = DepthOptions("5/3" if number % 4 == 2 else "9/7", 5, number % 4)
        beside = PictureOptions(order=number % 3, depth_share=0.6)
        streams.append(encode_to_size(image, _MAX_BYTES, chosen, options, beside).data)
    return tuple(streams)


def _depth(rng: np.random.Generator) -> NDArray[np.float64]:
    y, x = np.mgrid[:_HEIGHT, :_WIDTH].astype(np.float64)
    depth: NDArray[np.float64] = 10.0 + 0.1 * x + rng.uniform(0.0, 0.5, x.shape)
    depth[np.hypot(y - 18, x - 20) < 11] += 20.0
    depth[5:9, 30:] += 12.0
    return depth


def parts_of(data: bytes) -> tuple[int, DepthImageStream]:
    """Take a good stream apart."""
    stream = decode_stream(data)
    picture = stream.picture.data if stream.picture else b""
    code = len(stream.edges) + len(stream.depth.data) + len(picture)
    return len(data) - _CHECK_BYTES - code, stream


def mutate_depth_image(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage the header or one of the parts, and mend lengths and checksum, so that the damage is parsed."""
    start, stream = parts_of(data)
    match int(rng.integers(4)):
        case 0:
            changed = mutate(data[:start], rng) + data[start:-_CHECK_BYTES]
            return changed + zlib.crc32(changed).to_bytes(_CHECK_BYTES, "little")
        case 1:
            changed_stream = replace(stream, edges=mutate(stream.edges, rng))
        case 2:
            changed_stream = replace(stream, depth=replace(stream.depth, data=mutate(stream.depth.data, rng)))
        case _:
            if stream.picture is None:
                return data[: int(rng.integers(len(data)))]
            picture = replace(stream.picture, data=mutate(stream.picture.data, rng))
            changed_stream = replace(stream, picture=picture)
    return encode_stream(changed_stream)


def damaged_depth_images(number: int) -> bytes:
    """Return a mutation of a stream."""
    streams, rng = good_streams(), np.random.default_rng(number)
    data = streams[number % len(streams)]
    return mutate(data, rng) if rng.integers(4) == 0 else mutate_depth_image(data, rng)


def try_depth_images(damaged: bytes) -> str:
    """Decode a mutation of a stream, and render a view of what comes out."""
    data = nearest(good_streams(), damaged)
    start, stream = parts_of(data)
    must_decode = data.startswith(damaged) and len(damaged) >= start + len(stream.edges)
    try:
        decoded = decode(decode_stream(damaged))
        shape = decoded.depth.shape
        if decoded.pairs:
            shape = picture_of(render(decoded, LatticePosition(0.4, 0.0))).shape[:2]
    except BitstreamError:
        return "refused, but whole up to where it ends" if must_decode else "refused"
    if shape != decoded.stream.shape or not np.isfinite(decoded.depth).all():
        return f"a map or a view of {shape}, not {decoded.stream.shape}, or not finite"
    return "decoded"
