"""Scenes of what pays: never worse than the reference view alone, all of it at high rates."""

import contextlib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dvc.dibr.depth_image.depth_image_decoder import decode as decode_image
from dvc.dibr.depth_image.depth_image_encoder import DepthImage
from dvc.dibr.depth_image.depth_image_encoder import encode_to_size as encode_image
from dvc.dibr.depth_image.depth_scale import DepthScale
from dvc.dibr.depth_image.piece_decoder import decode
from dvc.dibr.depth_image.piece_encoder import encode_to_size
from dvc.dibr.depth_image.piece_rendering import render_pieces
from dvc.dibr.depth_image.piece_stream import decode_stream
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, layers_of
from dvc.dibr.layered.selection import MOST_TRIALS, SelectedPieces, encode_best
from dvc.dibr.layered.simplification import Price, alone, simplify
from dvc.dibr.layered.stack import (
    Stack,
    Worth,
    luma_from,
    rounded_to_labels,
    stack_of,
    viewpoints_of,
    worth_of,
)
from dvc.dibr.view_rendering import picture_of, render
from dvc.errors import ConfigError
from dvc.images.colour import luma
from tests.dibr.piece_scenes import canvas_of, odd_sprites, plane_layers, plane_sprites, sprite_of

SCENES = {"layers": plane_layers(), "sprites": plane_sprites()}


@cache
def best(name: str, max_bytes: int) -> SelectedPieces:
    """A stream, made once."""
    return encode_best(SCENES[name], max_bytes)


def views_mse(data: bytes, scene: Pieces) -> float:
    """Squared error of the views around."""
    found = decode(decode_stream(data)).scene
    errors = [luma_from(found, viewpoint) - luma_from(scene, viewpoint) for viewpoint in viewpoints_of(scene)]
    return float(np.mean(np.square(errors)))


@pytest.mark.parametrize("name", SCENES)
def test_views_are_never_worse_than_those_of_the_picture_with_its_map(name: str) -> None:
    scene = SCENES[name]
    reference = alone(stack_of(scene), scene.kind)
    errors = []
    for max_bytes in (250, 1200):
        found = best(name, max_bytes)
        assert len(found.encoded.data) <= max_bytes
        errors.append(views_mse(found.encoded.data, scene))
        assert errors[-1] == pytest.approx(found.squared_error)
        assert errors[-1] <= views_mse(encode_to_size(reference, max_bytes).data, scene)
        assert decode(decode_stream(found.encoded.data)).scene.kind is scene.kind
    assert errors == sorted(errors, reverse=True)


@pytest.mark.parametrize("max_bytes", [1500, 6000])
def test_the_reference_view_alone_is_worth_the_picture_with_its_map(max_bytes: int) -> None:
    scene = SCENES["layers"]
    reference = alone(stack_of(scene), scene.kind)
    (piece,) = reference.pieces
    disparity = piece.disparity.astype(np.float64)
    image = DepthImage(disparity, DepthScale.of(disparity), piece.colour)
    coded = encode_image(image, max_bytes, None)
    pieces = encode_to_size(reference, max_bytes)
    header = pieces.part_bytes["header"] - coded.part_bytes["header"]
    assert header <= 64
    pieces = encode_to_size(reference, max_bytes + header)
    found, expected = decode(decode_stream(pieces.data)).scene, decode_image(coded.stream)
    errors = []
    for view_of in (
        lambda viewpoint: render_pieces(found, viewpoint),
        lambda viewpoint: render(expected, viewpoint),
    ):
        views = [
            luma(picture_of(view_of(viewpoint))) - luma_from(scene, viewpoint)
            for viewpoint in viewpoints_of(scene)
        ]
        errors.append(float(np.mean(np.square(views))))
    assert 10.0 * np.log10(errors[0] / errors[1]) <= 0.05


def test_views_are_never_worse_than_with_disparities_rounded_to_labels() -> None:
    """Means of what cameras have voted for lie between labels."""
    scene = SCENES["layers"]
    rng = np.random.default_rng(3)
    pieces = []
    for piece in scene.pieces:
        disparity = piece.disparity + rng.uniform(-0.3, 0.3, piece.mask.shape).astype(np.float32)
        pieces.append(replace(piece, disparity=np.where(piece.mask, disparity, np.float32(0.0))))
    scene = Pieces(scene.canvas, scene.kind, tuple(pieces))
    stack = stack_of(scene)
    found = encode_best(scene, 400)
    for one in (stack, rounded_to_labels(stack)):
        reference = encode_to_size(alone(one, scene.kind), 400)
        assert found.squared_error <= views_mse(reference.data, scene)


def least_bytes(scene: Pieces) -> int:
    """The shortest file, to eight bytes."""
    for max_bytes in range(64, 600, 8):
        with contextlib.suppress(ConfigError):
            encode_to_size(scene, max_bytes)
            return max_bytes
    raise AssertionError


def test_a_few_bytes_give_the_reference_view_alone_where_all_masks_do_not_fit() -> None:
    scene = SCENES["sprites"]
    reference = alone(stack_of(scene), scene.kind)
    assert least_bytes(reference) < least_bytes(scene)
    found = best("sprites", least_bytes(reference)).scene
    assert len(found.pieces) == 1
    assert found.pieces[0].mask.all()
    assert found.pieces[0].mask.shape == reference.pieces[0].mask.shape


def test_enough_bytes_give_all_values() -> None:
    found = best("layers", 12_000).scene
    for one, other in zip(found.pieces, SCENES["layers"].pieces, strict=True):
        np.testing.assert_array_equal(one.mask, other.mask)


def _stack() -> Stack:
    return stack_of(SCENES["layers"])


def test_larger_multipliers_keep_less() -> None:
    scene, stack = SCENES["layers"], _stack()
    worth = worth_of(stack, alone(stack, scene.kind), viewpoints_of(scene))
    kept = [
        simplify(stack, Kind.LAYERS, worth, Price(multiplier, 1.0, 0.0)).scene.num_values
        for multiplier in (1e6, 300.0, 30.0, 1e-3)
    ]
    frame = scene.canvas.frame
    assert kept[0] == frame.width * frame.height
    assert kept == sorted(kept)
    assert kept[-1] > kept[0]


@pytest.mark.parametrize(("saved_bits", "is_kept"), [(215.0, False), (233.0, True)])
def test_a_layer_is_kept_if_it_saves_more_than_its_bits(saved_bits: float, is_kept: bool) -> None:
    """A second layer of the whole frame, without edges: 28 bytes of header, and its code."""
    shape, price = (16, 16), Price(multiplier=2.0, bits_per_pixel=0.5, squared_error=0.0)
    colour, disparity = np.zeros((2, *shape, 3), np.uint8), np.zeros((2, *shape), np.float32)
    disparity[0] = 4.0
    stack = Stack(canvas_of(shape), colour, disparity, np.ones((2, *shape), np.bool_))
    saved = np.ones((2, *shape)) * price.multiplier * (0.5 + saved_bits / 256)
    found = simplify(stack, Kind.LAYERS, Worth(saved, np.ones((2, *shape))), price)
    assert len(found.scene.pieces) == 1 + is_kept


def test_what_is_kept_lies_behind_what_is_before_it() -> None:
    scene, stack = SCENES["layers"], _stack()
    worth = worth_of(stack, alone(stack, scene.kind), viewpoints_of(scene))
    simplified = simplify(stack, Kind.LAYERS, worth, Price(1e-3, 1.0, 0.0))
    assert len(simplified.scene.pieces) > 1
    assert len(simplified.weights) == len(simplified.scene.pieces)
    assert simplified.weights[0] == 1.0
    image = layers_of(simplified.scene)
    for piece, mask in zip(simplified.scene.pieces, image.occupied, strict=True):
        assert piece.num_values == mask.sum(), "nothing needs to be moved or left out"
        index = piece.slices
        known = stack.occupied[0][index] & piece.mask
        assert known.any()
    behind = image.occupied[1:]
    assert (image.disparity[1:] < image.disparity[:-1])[behind].all()


def test_trials_are_counted_and_odd_scenes_borne() -> None:
    empty = Pieces(canvas_of((12, 20)), Kind.LAYERS, ())
    single = Pieces(canvas_of((12, 20)), Kind.SPRITES, (sprite_of(np.ones((1, 1), np.bool_), 3, 5),))
    for scene in (odd_sprites(), empty, single):
        steps: list[int] = []
        found = encode_best(scene, 900, advance=steps.append)
        assert sum(steps) == MOST_TRIALS
        assert decode(decode_stream(found.encoded.data)).damage is None


def test_too_few_bytes_are_refused() -> None:
    with pytest.raises(ConfigError, match="header and masks take"):
        encode_best(SCENES["layers"], 60)
