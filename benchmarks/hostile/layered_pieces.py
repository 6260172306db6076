"""Streams of layers and sprites: good ones, their mutations, and their decoder."""

import zlib
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.hostile.mutations import mutate, nearest
from dvc.dibr.depth_image.piece_encoder import encode_to_size
from dvc.dibr.depth_image.piece_stream import decode, decode_stream, encode_stream
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, render_pieces
from dvc.dibr.view_rendering import picture_of
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.sprites import Sprite

_SHAPE = 40, 52
_CANVAS = Canvas(_SHAPE, Frame(4, 2, 44, 34), DisparityLabels(0.0, 1.0, 32), 1.0, "middle", 3)
_CHECK_BYTES = 4
_MAX_BYTES = 1500
_MOST_RENDERED_PX = 1 << 18
"""Larger frames are only decoded: that they need memory is no harm."""


@cache
def good_streams() -> tuple[bytes, ...]:
    """Encode small layers and sprites."""
    rng = np.random.default_rng(11)
    y, x = np.indices(_SHAPE)
    disc = np.hypot(y - 18, x - 25) < 12
    layers = np.ones(_SHAPE, np.bool_), disc, disc & (x > 20), disc & (x > 99)
    sprites = disc, rng.random(_SHAPE) < 0.1, (y == 7) & (x == 9)
    streams = []
    for kind, masks, channels in (
        (Kind.LAYERS, layers, 3),
        (Kind.LAYERS, layers, 1),
        (Kind.SPRITES, sprites, 3),
    ):
        pieces = []
        for number, mask in enumerate(masks):
            colour = rng.integers(0, 256, (*_SHAPE, channels), np.uint8)
            pieces.append(_piece(mask, np.broadcast_to(colour, (*_SHAPE, 3)), 20.0 - 4.0 * number + 0.05 * x))
        streams.append(encode_to_size(Pieces(_CANVAS, kind, tuple(pieces)), _MAX_BYTES).data)
    return tuple(streams)


def _piece(mask: NDArray[np.bool_], colour: NDArray[np.uint8], disparity: NDArray[np.floating]) -> Sprite:
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    inside = np.s_[top : top + height, left : left + width]
    kept = mask[inside]
    levels = (disparity[inside] * kept).astype(np.float32)
    return Sprite(left, top, kept, colour[inside] * kept[..., None], levels)


def mutate_pieces(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage the header or a part of a piece, and mend lengths and checksum, so that the damage is parsed."""
    stream = decode_stream(data)
    if rng.integers(4) == 0:
        start = stream.num_header_bytes
        header = mutate(data[: start - _CHECK_BYTES], rng)
        return header + zlib.crc32(header).to_bytes(_CHECK_BYTES, "little") + data[start:]
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
    return encode_stream(stream.canvas, stream.kind, stream.rectangles, pieces)


def damaged_pieces(number: int) -> bytes:
    """Return a mutation of a stream."""
    streams, rng = good_streams(), np.random.default_rng(number)
    data = streams[number % len(streams)]
    return mutate(data, rng) if rng.integers(4) == 0 else mutate_pieces(data, rng)


def try_pieces(damaged: bytes) -> str:
    """Decode a mutation of a stream, and render a view of what comes out."""
    data = nearest(good_streams(), damaged)
    try:
        decoded = decode(decode_stream(damaged))
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
    """Whether the first piece of a stream is whole where it is cut."""
    stream = decode_stream(data)
    alone = encode_stream(stream.canvas, stream.kind, stream.rectangles[:1], stream.pieces[:1])
    header = encode_stream(stream.canvas, stream.kind, stream.rectangles[:1], [None])
    return length >= stream.num_header_bytes + len(alone) - len(header)
