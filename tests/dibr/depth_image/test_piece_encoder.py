"""Coding of layers and sprites: sizes, quality, odd pieces, cuts and mutations, folders."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.dibr.depth_image.depth_image_encoder import DepthOptions
from dvc.dibr.depth_image.piece_encoder import Choices, allot, encode_to_size
from dvc.dibr.depth_image.piece_stream import DecodedPieces, decode, decode_stream
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, layers_of, read_pieces, write_pieces
from dvc.errors import BitstreamError
from dvc.images import picture_codec
from dvc.layers.canvas import Frame
from dvc.layers.sprites import Sprite
from tests.dibr.piece_scenes import canvas_of, odd_sprites, plane_layers, plane_sprites, sprite_of

SCENES = {"layers": plane_layers(), "sprites": plane_sprites(), "odd": odd_sprites()}


@cache
def small() -> bytes:
    """A small stream, made once."""
    return encode_to_size(odd_sprites(), 600).data


def decoded(data: bytes) -> DecodedPieces:
    return decode(decode_stream(data))


def psnr(found: Pieces, scene: Pieces) -> float:
    errors = [
        one.colour[one.mask].astype(float) - other.colour[other.mask]
        for one, other in zip(found.pieces, scene.pieces, strict=True)
    ]
    return float(10 * np.log10(255**2 / np.mean(np.concatenate(errors) ** 2)))


@pytest.mark.parametrize("name", SCENES)
def test_pieces_come_back_with_their_masks_and_better_at_higher_rates(name: str) -> None:
    scene = SCENES[name]
    qualities = []
    for max_bytes in (1200, 40_000):
        encoded = encode_to_size(scene, max_bytes)
        assert sum(encoded.part_bytes.values()) == len(encoded.data) <= max_bytes
        assert len(encoded.data) >= max_bytes - 16 or max_bytes > 1200
        found = decoded(encoded.data)
        assert found.damage is None
        assert found.scene.kind is scene.kind
        for one, other in zip(found.scene.pieces, scene.pieces, strict=True):
            np.testing.assert_array_equal(one.mask, other.mask)
            assert (one.left, one.top) == (other.left, other.top)
            assert not one.colour[~one.mask].any()
            assert not one.disparity[~one.mask].any()
        qualities.append(psnr(found.scene, scene))
    assert qualities == sorted(qualities)
    assert qualities[-1] > 48
    for one, other in zip(found.scene.pieces, scene.pieces, strict=True):
        np.testing.assert_allclose(one.disparity, other.disparity, atol=0.01)


def test_gray_and_other_options() -> None:
    scene = SCENES["sprites"]
    pieces = [replace(one, colour=np.repeat(one.colour[..., :1], 3, axis=2)) for one in scene.pieces]
    gray = replace(scene, pieces=tuple(pieces))
    found = decoded(encode_to_size(gray, 1000).data).scene
    assert all((piece.colour == piece.colour[..., :1]).all() for piece in found.pieces)
    assert psnr(found, gray) > psnr(decoded(encode_to_size(scene, 1000).data).scene, scene)
    shares = [
        encode_to_size(SCENES["odd"], 1200, DepthOptions(depth_share=share)).part_bytes["image"]
        for share in (0.1, 0.6)
    ]
    assert shares[0] > shares[1]
    assert decoded(encode_to_size(scene, 2000, gray=True).data).damage is None


def test_empty_layers() -> None:
    piece = sprite_of(np.ones((12, 20), np.bool_))
    nothing = np.zeros((0, 0), np.bool_)
    empty = Sprite(0, 0, nothing, np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.float32))
    for pieces in ((piece, empty), (empty,)):
        scene = Pieces(canvas_of((12, 20)), Kind.LAYERS, pieces)
        found = decoded(encode_to_size(scene, 600).data)
        assert found.damage is None
        assert [one.mask.shape for one in found.scene.pieces] == [one.mask.shape for one in pieces]
        assert layers_of(found.scene).votes.shape == (len(pieces), 12, 20)


def test_layers_lie_behind_each_other_whatever_coding_does() -> None:
    scene = SCENES["layers"]
    image = layers_of(decoded(encode_to_size(scene, 700).data).scene)
    behind = image.occupied[1:]
    assert behind.any()
    assert (image.disparity[1:] < image.disparity[:-1])[behind].all()
    assert image.occupied[:-1][behind].all()


@pytest.mark.parametrize("name", SCENES)
def test_folders_are_read_by_the_commands_of_stereo(name: str, tmp_path: Path) -> None:
    scene = decoded(encode_to_size(SCENES[name], 1500).data).scene
    write_pieces(tmp_path, scene)
    again = read_pieces(tmp_path)
    assert again.kind is scene.kind
    for part in ("frame", "labels", "reference"):
        assert getattr(again.canvas, part) == getattr(SCENES[name].canvas, part)
    assert again.num_values == scene.num_values
    assert encode_to_size(again, 3000).part_bytes["image"] > 0


def test_calibrated_canvases() -> None:
    matrix = np.array([[1, 0, 0, -3], [0, 1, 0, -2], [0, 0, 0, 40], [0, 0, 0.5, 0.25]], float)
    canvas = canvas_of((12, 20), world_from_rectified=matrix, frame=Frame(2, 1, 15, 9))
    scene = Pieces(canvas, Kind.LAYERS, (sprite_of(np.ones((12, 20), np.bool_)),))
    found = decoded(encode_to_size(scene, 600).data).scene.canvas
    np.testing.assert_array_equal(found.world_from_rectified, matrix)
    assert found.frame == canvas.frame
    assert (found.num_cameras, found.reference, found.resolution) == (3, "middle", 1.0)


def test_a_stream_cut_anywhere_gives_the_first_pieces_or_says_where_it_ends() -> None:
    whole = decoded(small()).scene.pieces
    counts = []
    for length in range(0, len(small()), 3):
        try:
            found = decoded(small()[:length])
        except BitstreamError:
            assert not counts, "once there is a piece, more bytes leave it"
            continue
        assert found.damage is not None
        assert f"of {len(small())} bytes" in found.damage
        pieces = found.scene.pieces
        counts.append(len(pieces))
        for one, other in zip(pieces[:-1], whole, strict=False):
            np.testing.assert_array_equal(one.colour, other.colour)
        np.testing.assert_array_equal(pieces[-1].mask, whole[len(pieces) - 1].mask)
    assert decoded(small() + b"more").damage == "4 bytes follow"
    assert counts == sorted(counts)
    assert set(counts) == set(range(1, len(whole) + 1))


@given(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255))
@settings(max_examples=60)
def test_mutations_are_refused_or_leave_what_precedes_them(share: float, change: int) -> None:
    data = bytearray(small())
    data[int(share * len(data))] ^= change
    try:
        found = decoded(bytes(data))
    except BitstreamError:
        return
    assert found.damage is not None
    whole = decoded(small()).scene.pieces
    for one, other in zip(found.scene.pieces, whole, strict=False):
        np.testing.assert_array_equal(one.colour, other.colour)


RNG = np.random.default_rng(0)
HARD, EASY = (picture_codec.encode(128 + RNG.normal(size=(32, 32)) * size) for size in (40.0, 8.0))


def test_bytes_are_divided_by_what_they_are_worth() -> None:
    for total in (100, 500, 1000):
        found = allot([Choices((HARD,), (0,)), Choices((EASY,), (0,))], total)
        assert found is not None
        assert sum(found) == total
        assert found[0] > found[1]
    found = allot([Choices((HARD,), (0,)), Choices((EASY,), (0,))], 10**6)
    assert found is not None
    assert sum(found) < 10**6
    needed = [Choices((HARD,), (60,)), Choices((EASY,), (50,))]
    assert allot(needed, 100) is None
    assert allot(needed, 110) == [60, 50]


def test_the_cheaper_of_two_codes_is_taken() -> None:
    both = Choices((HARD, HARD), (200, 3))
    for multiplier in (1e-7, 1e-4, 1e-2):
        assert both.bytes_at_multiplier(multiplier) == 3 + HARD.bytes_at_multiplier(multiplier)


def test_where_nothing_but_what_is_needed_fits_there_is_no_code() -> None:
    dear = Choices((HARD, EASY), (40, 30), 1e6)
    assert dear.bytes_at_multiplier(10.0) > 40
    assert allot([dear, dear], 60) == [30, 30]
    assert allot([dear, dear], 59) is None
