"""Streams of layers and sprites: headers that cannot have been written are refused, damage behind checks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.array_files import MIN_STEP
from dvc.dibr.depth_image.piece_encoder import encode_to_size
from dvc.dibr.depth_image.piece_stream import (
    LayeredStream,
    decode,
    decode_stream,
    encode_header,
    encode_stream,
)
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces
from dvc.errors import BitstreamError, ConfigError
from dvc.geometry.camera_array import DisparityLabels
from dvc.layers.canvas import Frame
from tests.dibr.piece_scenes import canvas_of, odd_sprites, sprite_of

CANVAS = canvas_of((12, 20))
SCENE = Pieces(CANVAS, Kind.SPRITES, (sprite_of(np.ones((5, 6), np.bool_)),) * 2)


@cache
def odd() -> bytes:
    """A stream of sprites of odd shapes, made once."""
    return encode_to_size(odd_sprites(), 700).data


@cache
def two_alike() -> LayeredStream:
    """A stream of two sprites that are alike, made once."""
    return decode_stream(encode_to_size(SCENE, 400).data)


def test_streams_come_back() -> None:
    first = two_alike()
    again = decode_stream(encode_stream(first.canvas, first.kind, first.rectangles, first.pieces))
    assert again.rectangles == first.rectangles == (Frame(0, 0, 6, 5),) * 2
    assert [piece.depth.data for piece in again.pieces if piece] == [
        piece.depth.data for piece in first.pieces if piece
    ]
    assert again.num_header_bytes == len(encode_header(CANVAS, Kind.SPRITES, again.rectangles, (1, 1)))


def test_the_least_step_comes_back() -> None:
    canvas = canvas_of((12, 20), labels=DisparityLabels(0.0, MIN_STEP, 16))
    found = decode_stream(encode_to_size(replace(SCENE, canvas=canvas), 400).data).canvas
    assert found.labels.step == pytest.approx(MIN_STEP)


@pytest.mark.parametrize(
    "canvas",
    [
        replace(CANVAS, frame=Frame(10, 0, 20, 12)),
        replace(CANVAS, num_cameras=0),
        replace(CANVAS, resolution=0.0),
        replace(CANVAS, resolution=float("nan")),
        replace(CANVAS, world_from_rectified=np.zeros((4, 4))),
        replace(CANVAS, shape=(65535, 65535)),
    ],
)
def test_canvases_that_cannot_be_are_refused(canvas) -> None:
    if canvas.shape != CANVAS.shape:
        with pytest.raises(ConfigError, match="canvas"):
            encode_header(canvas, Kind.LAYERS, [], [])
        return
    with pytest.raises(BitstreamError, match="cannot have been written"):
        decode_stream(encode_header(canvas, Kind.LAYERS, [], []))


@pytest.mark.parametrize("rectangle", [Frame(15, 0, 6, 5), Frame(0, 8, 6, 5), Frame(0, 0, 0, 5)])
def test_rectangles_beyond_the_canvas_are_refused(rectangle: Frame) -> None:
    with pytest.raises(BitstreamError, match="cannot have been written"):
        decode_stream(encode_header(CANVAS, Kind.LAYERS, [rectangle], [10]))


def test_more_pieces_than_there_may_be_are_refused() -> None:
    for kind, size in ((Kind.LAYERS, (2, 2)), (Kind.SPRITES, (2**12, 2**12))):
        rectangles = [Frame(0, 0, *size)] * 9
        canvas = canvas_of(size)
        with pytest.raises(BitstreamError, match="cannot have been written"):
            decode_stream(encode_header(canvas, kind, rectangles, [1] * 9))


def test_other_versions_and_files_are_refused() -> None:
    with pytest.raises(BitstreamError, match="DIBR"):
        decode_stream(b"none")
    with pytest.raises(BitstreamError, match="header"):
        decode_stream(b"DIBR\x05")


@given(st.data())
@settings(max_examples=60)
def test_damage_behind_right_checksums_is_refused_or_some_picture(data) -> None:
    stream = decode_stream(odd())
    number = data.draw(st.integers(0, len(stream.pieces) - 1))
    piece = stream.pieces[number]
    assert piece is not None
    content = bytearray(piece.edges)
    position = data.draw(st.integers(0, len(content) - 1))
    content[position] ^= data.draw(st.integers(1, 255))
    pieces = list(stream.pieces)
    pieces[number] = replace(piece, edges=bytes(content))
    changed = encode_stream(stream.canvas, stream.kind, stream.rectangles, pieces)
    try:
        found = decode(decode_stream(changed))
    except BitstreamError:
        assert number == 0
        return
    assert len(found.scene.pieces) >= number
    assert changed != odd()
