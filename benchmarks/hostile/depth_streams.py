"""Streams with depth: good ones, their mutations, and their decoders."""

import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.hostile.mutations import Change, mutate, nearest
from dvc.dibr.depth_image.depth_image_encoder import DepthImage, DepthOptions, code_edges
from dvc.dibr.depth_image.depth_image_encoder import encode_to_size as encode_map
from dvc.dibr.depth_image.depth_image_stream import DepthImageStream, DepthScale
from dvc.dibr.depth_image.depth_image_stream import decode as decode_map
from dvc.dibr.depth_image.depth_image_stream import decode_stream as decode_depth_image
from dvc.dibr.depth_image.depth_image_stream import encode_stream as encode_depth_image
from dvc.dibr.depth_image.piece_encoder import encode_to_size as encode_layers
from dvc.dibr.depth_image.piece_stream import decode as decode_layers
from dvc.dibr.depth_image.piece_stream import decode_stream as decode_pieces
from dvc.dibr.depth_image.piece_stream import encode_stream as encode_pieces
from dvc.dibr.depth_image.scene_pieces import Kind as PieceKind
from dvc.dibr.depth_image.scene_pieces import Pieces, render_pieces
from dvc.dibr.dibr_streams import BUILT_IN_CODECS
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_rendering import picture_of
from dvc.dibr.view_rendering import render as render_pairs
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import PairLayer, decode_header, encode_layer
from dvc.dibr.view_stream import decode as decode_pairs
from dvc.dibr.view_stream import decode_stream as decode_views
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint, between
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import edges_of_jumps
from dvc.layers.canvas import Canvas
from dvc.layers.canvas import Frame as CanvasFrame
from dvc.layers.sprites import Sprite

NUM_LAYERS = 2
_HEIGHT, _WIDTH = 21, 34
_CHECK_BYTES = 4


def damaged_of(good: Callable[[], tuple[bytes, ...]], change: Change, number: int) -> bytes:
    """Return a mutation of one of several streams: a quarter anywhere, the rest below the checksums."""
    streams, rng = good(), np.random.default_rng(number)
    stream = streams[number % len(streams)]
    return mutate(stream, rng) if rng.integers(4) == 0 else change(stream, rng)


def _with_checksum(head: bytes) -> bytes:
    return head + zlib.crc32(head).to_bytes(_CHECK_BYTES, "little")


@cache
def good_views() -> tuple[bytes, ...]:
    """Encode small views in all ways."""
    streams = []
    for number, method in enumerate(BUILT_IN_CODECS):
        for calibrated in (False, True):
            coloured = (number + calibrated) % 2 == 1
            views = _views(coloured, calibrated, references=(0, 2) if number % 3 == 0 else (0,))
            labels = DisparityLabels(0.05, 0.025, 7) if calibrated else DisparityLabels(0.0, 1.0, 7)
            streams.append(ViewEncoder(views, labels, method, NUM_LAYERS).encode(2e-3).data)
    return tuple(streams)


def _views(coloured: bool, calibrated: bool, references: tuple[int, ...]) -> Views:
    rng = np.random.default_rng(3)
    channels = 3 if coloured else 1
    near, far = (rng.integers(0, 256, (_HEIGHT, _WIDTH + 12, channels), np.uint8) for _ in range(2))
    pictures = []
    for m in range(3):
        picture = far[:, m : m + _WIDTH].copy()
        left = 16 - 5 * m
        picture[6:15, max(left, 0) : left + 12] = near[6:15, max(-left, 0) : 12]
        pictures.append(picture if coloured else picture[:, :, 0])
    return Views(tuple(pictures), tuple(_viewpoint(m, calibrated) for m in range(3)), references)


def _viewpoint(m: int, calibrated: bool) -> Viewpoint:
    if not calibrated:
        return LatticePosition(float(m), 0.0)
    intrinsic = np.array([[30.0, 0.0, 16.5], [0.0, 30.0, 10.0], [0.0, 0.0, 1.0]])
    return CalibratedViewpoint(intrinsic, np.column_stack([np.eye(3), [-float(m), 0.0, 0.0]]))


def mutate_pictures(stream: bytes, rng: np.random.Generator) -> bytes:
    """Damage the header, or one part of one layer, and mend its checksum, so that the damage is parsed."""
    found = decode_views(stream)
    _, start = decode_header(stream)
    if rng.integers(4) == 0:
        return _with_checksum(mutate(stream[: start - _CHECK_BYTES], rng)) + stream[start:]
    layers = [list(layer) for layer in found.layers]
    layer, pair, part = (int(rng.integers(size)) for size in (len(layers), len(layers[0]), 2))
    parts = list(layers[layer][pair])
    parts[part] = mutate(parts[part], rng)
    layers[layer][pair] = PairLayer(*parts)
    return stream[:start] + b"".join(encode_layer(tuple(layer)) for layer in layers)


def try_pictures(damaged: bytes) -> str:
    """Decode a mutation of a stream, and render a view from the result."""
    stream = nearest(good_views(), damaged)
    intact = _num_intact(stream, damaged)
    try:
        decoded = decode_pairs(decode_views(damaged))
        viewpoints = decoded.header.viewpoints
        view = picture_of(render_pairs(decoded, between(viewpoints[0], viewpoints[-1], 0.4)))
    except BitstreamError:
        return "refused" if intact == 0 else f"refused, but {intact} layers are whole"
    if view.shape[:2] != decoded.header.shape:
        return f"a view of {view.shape}, not {decoded.header.shape}"
    lost = decoded.num_layers < intact
    return f"a whole layer is lost: {decoded.num_layers} of {intact}" if lost else "decoded"


def _num_intact(stream: bytes, damaged: bytes) -> int:
    """Return how many layers precede the damage."""
    _, end = decode_header(stream)
    intact = 0
    for layer in decode_views(stream).layers:
        end += len(encode_layer(layer))
        intact += damaged[:end] == stream[:end]
    return intact


_MAP_HEIGHT, _MAP_WIDTH = 37, 50
_MAX_MAP_BYTES = 600


@cache
def good_depth_images() -> tuple[bytes, ...]:
    """Encode a small map, and pictures with it, in all ways."""
    rng = np.random.default_rng(5)
    depth = _depth(rng)
    edges = edges_of_jumps(depth, 4.0)
    coloured = rng.integers(0, 256, (_MAP_HEIGHT, _MAP_WIDTH, 3), np.uint8)
    pictures = None, coloured[:, :, 0], coloured
    streams = []
    for number in range(8):
        scale = DepthScale.of(depth, *((0.25, -1.0) if number % 2 else (1.0, 0.0)))
        image = DepthImage(depth, scale, pictures[number % 3])
        chosen = code_edges(
            EdgeMaps.none(edges.shape) if number == 6 else edges,
            EdgeCode.FIXED if number % 4 == 1 else EdgeCode.ADAPTIVE,
        )
        options = DepthOptions("5/3" if number % 4 == 2 else "9/7", 5, number % 4, number % 3, 0.6)
        streams.append(encode_map(image, _MAX_MAP_BYTES, chosen, options).data)
    return tuple(streams)


def _depth(rng: np.random.Generator) -> NDArray[np.float64]:
    y, x = np.mgrid[:_MAP_HEIGHT, :_MAP_WIDTH].astype(np.float64)
    depth: NDArray[np.float64] = 10.0 + 0.1 * x + rng.uniform(0.0, 0.5, x.shape)
    depth[np.hypot(y - 18, x - 20) < 11] += 20.0
    depth[5:9, 30:] += 12.0
    return depth


def parts_of(data: bytes) -> tuple[int, DepthImageStream]:
    """Take a good stream apart."""
    stream = decode_depth_image(data)
    picture = stream.picture.data if stream.picture else b""
    code = len(stream.edges) + len(stream.depth.data) + len(picture)
    return len(data) - _CHECK_BYTES - code, stream


def mutate_depth_image(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage the header or one of the parts, and mend lengths and checksum, so that the damage is parsed."""
    start, stream = parts_of(data)
    match int(rng.integers(4)):
        case 0:
            return _with_checksum(mutate(data[:start], rng) + data[start:-_CHECK_BYTES])
        case 1:
            changed_stream = replace(stream, edges=mutate(stream.edges, rng))
        case 2:
            changed_stream = replace(stream, depth=replace(stream.depth, data=mutate(stream.depth.data, rng)))
        case _:
            if stream.picture is None:
                return data[: int(rng.integers(len(data)))]
            picture = replace(stream.picture, data=mutate(stream.picture.data, rng))
            changed_stream = replace(stream, picture=picture)
    return encode_depth_image(changed_stream)


def try_depth_images(damaged: bytes) -> str:
    """Decode a mutation of a stream, and render a view from the result."""
    data = nearest(good_depth_images(), damaged)
    start, stream = parts_of(data)
    must_decode = data.startswith(damaged) and len(damaged) >= start + len(stream.edges)
    try:
        decoded = decode_map(decode_depth_image(damaged))
        shape = decoded.depth.shape
        if decoded.pairs:
            shape = picture_of(render_pairs(decoded, LatticePosition(0.4, 0.0))).shape[:2]
    except BitstreamError:
        return "refused, but its edges are whole" if must_decode else "refused"
    if shape != decoded.stream.shape or not np.isfinite(decoded.depth).all():
        return f"a map or a view of {shape}, not {decoded.stream.shape}, or not finite"
    return "decoded"


_SHAPE = 40, 52
_CANVAS = Canvas(_SHAPE, CanvasFrame(4, 2, 44, 34), DisparityLabels(0.0, 1.0, 32), 1.0, "middle", 3)
_MAX_BYTES = 1500
_MOST_RENDERED_PX = 1 << 18
"""Larger frames are only decoded: that they need memory is no harm."""


@cache
def good_pieces() -> tuple[bytes, ...]:
    """Encode small layers and sprites."""
    rng = np.random.default_rng(11)
    y, x = np.indices(_SHAPE)
    disc = np.hypot(y - 18, x - 25) < 12
    layers = np.ones(_SHAPE, np.bool_), disc, disc & (x > 20), disc & (x > 99)
    sprites = disc, rng.random(_SHAPE) < 0.1, (y == 7) & (x == 9)
    streams = []
    for kind, masks, channels in (
        (PieceKind.LAYERS, layers, 3),
        (PieceKind.LAYERS, layers, 1),
        (PieceKind.SPRITES, sprites, 3),
    ):
        pieces = []
        for number, mask in enumerate(masks):
            colour = rng.integers(0, 256, (*_SHAPE, channels), np.uint8)
            pieces.append(_piece(mask, np.broadcast_to(colour, (*_SHAPE, 3)), 20.0 - 4.0 * number + 0.05 * x))
        streams.append(encode_layers(Pieces(_CANVAS, kind, tuple(pieces)), _MAX_BYTES).data)
    return tuple(streams)


def _piece(mask: NDArray[np.bool_], colour: NDArray[np.uint8], disparity: NDArray[np.floating]) -> Sprite:
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    inside = np.s_[top : top + height, left : left + width]
    kept = mask[inside]
    levels = (disparity[inside] * kept).astype(np.float32)
    return Sprite(left, top, kept, colour[inside] * kept[..., None], levels)


def mutate_pieces(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage the header or a part of a piece, and mend lengths and checksum, so that the damage is parsed."""
    stream = decode_pieces(data)
    if rng.integers(4) == 0:
        start = stream.num_header_bytes
        return _with_checksum(mutate(data[: start - _CHECK_BYTES], rng)) + data[start:]
    pieces = list(stream.pieces)
    number = int(rng.choice([index for index, piece in enumerate(pieces) if piece is not None]))
    piece = pieces[number]
    assert piece is not None
    picture = piece.picture
    assert picture is not None
    match int(rng.integers(3)):
        case 0:
            piece = replace(piece, edges=mutate(piece.edges, rng))
        case 1:
            piece = replace(piece, depth=replace(piece.depth, data=mutate(piece.depth.data, rng)))
        case _:
            piece = replace(piece, picture=replace(picture, data=mutate(picture.data, rng)))
    pieces[number] = piece
    return encode_pieces(stream.canvas, stream.kind, stream.rectangles, pieces)


def try_pieces(damaged: bytes) -> str:
    """Decode a mutation of a stream, and render a view from the result."""
    data = nearest(good_pieces(), damaged)
    try:
        decoded = decode_layers(decode_pieces(damaged))
    except BitstreamError:
        is_whole = data.startswith(damaged) and _has_a_piece(data, len(damaged))
        return "refused, but its first piece is whole" if is_whole else "refused"
    if not all(np.isfinite(piece.disparity).all() for piece in decoded.scene.pieces):
        return "disparities that are not finite"
    height, width = decoded.shape
    if height * width <= _MOST_RENDERED_PX:
        view = render_pieces(decoded.scene, LatticePosition(0.4, 0.0))
        if picture_of(view).shape != (height, width, 3):
            return f"a view of {view.image.shape}, not {decoded.shape}"
    return "decoded"


def _has_a_piece(data: bytes, length: int) -> bool:
    """Return whether a cut stream has its whole first piece."""
    stream = decode_pieces(data)
    first = encode_pieces(stream.canvas, stream.kind, stream.rectangles[:1], stream.pieces[:1])
    header = encode_pieces(stream.canvas, stream.kind, stream.rectangles[:1], [None])
    return length >= stream.num_header_bytes + len(first) - len(header)
