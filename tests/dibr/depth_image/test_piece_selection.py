"""Selection of values: never worse than the reference view only, all values at high rates; masks, stacks."""

import contextlib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dvc.dibr.depth_image.depth_image_encoder import DepthImage
from dvc.dibr.depth_image.depth_image_encoder import encode_to_size as encode_image
from dvc.dibr.depth_image.depth_image_stream import DepthScale
from dvc.dibr.depth_image.depth_image_stream import decode as decode_image
from dvc.dibr.depth_image.piece_encoder import encode_to_size
from dvc.dibr.depth_image.piece_selection import (
    MOST_TRIALS,
    Price,
    SelectedPieces,
    Stack,
    Worth,
    best_mask,
    encode_best,
    reference_of,
    rounded_to_labels,
    select,
    stack_of,
    viewpoints_of,
    worth_of,
)
from dvc.dibr.depth_image.piece_stream import decode, decode_stream
from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, layers_of, luma_from
from dvc.dibr.view_rendering import picture_of, render
from dvc.errors import ConfigError
from dvc.geometry.camera_array import DisparityLabels
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
    reference = reference_of(stack_of(scene), scene.kind)
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
    reference = reference_of(stack_of(scene), scene.kind)
    (piece,) = reference.pieces
    disparity = piece.disparity.astype(np.float64)
    image = DepthImage(disparity, DepthScale.of(disparity), piece.colour)
    coded = encode_image(image, max_bytes, None)
    pieces = encode_to_size(reference, max_bytes)
    header = pieces.part_bytes["header"] - coded.part_bytes["header"]
    assert header <= 64
    pieces = encode_to_size(reference, max_bytes + header)
    found, expected = decode(decode_stream(pieces.data)).scene, decode_image(coded.stream)
    errors = np.zeros(2)
    for viewpoint in viewpoints_of(scene):
        views = luma_from(found, viewpoint), luma(picture_of(render(expected, viewpoint)))
        errors += [np.mean(np.square(view - luma_from(scene, viewpoint))) for view in views]
    assert 10.0 * np.log10(errors[0] / errors[1]) <= 0.05


def test_views_are_never_worse_than_with_disparities_rounded_to_labels() -> None:
    scene = SCENES["layers"]
    rng = np.random.default_rng(3)
    noise = [rng.uniform(-0.3, 0.3, piece.mask.shape).astype(np.float32) for piece in scene.pieces]
    moved = [(one.disparity + more) * one.mask for one, more in zip(scene.pieces, noise, strict=True)]
    pieces = tuple(replace(one, disparity=to) for one, to in zip(scene.pieces, moved, strict=True))
    scene = replace(scene, pieces=pieces)
    stack = stack_of(scene)
    found = encode_best(scene, 400)
    for one in (stack, rounded_to_labels(stack)):
        reference = encode_to_size(reference_of(one, scene.kind), 400)
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
    reference = reference_of(stack_of(scene), scene.kind)
    assert least_bytes(reference) < least_bytes(scene)
    found = best("sprites", least_bytes(reference)).scene
    assert len(found.pieces) == 1
    assert found.pieces[0].mask.all()
    assert found.pieces[0].mask.shape == reference.pieces[0].mask.shape


def test_enough_bytes_give_all_values() -> None:
    found = best("layers", 12_000).scene
    for one, other in zip(found.pieces, SCENES["layers"].pieces, strict=True):
        np.testing.assert_array_equal(one.mask, other.mask)


def test_larger_multipliers_keep_less_and_values_lie_behind_each_other() -> None:
    scene, stack = SCENES["layers"], stack_of(SCENES["layers"])
    worth = worth_of(stack, reference_of(stack, scene.kind), viewpoints_of(scene))
    counts = []
    for multiplier in (1e6, 300.0, 30.0, 1e-3):
        selected, weights = select(stack, Kind.LAYERS, worth, Price(multiplier, 1.0, 0.0))
        counts.append(selected.num_values)
    frame = scene.canvas.frame
    assert counts[0] == frame.width * frame.height
    assert counts == sorted(counts)
    assert len(weights) == len(selected.pieces) > 1
    assert weights[0] == 1.0
    image = layers_of(selected)
    for piece, mask in zip(selected.pieces, image.occupied, strict=True):
        assert piece.num_values == mask.sum(), "nothing needs to be moved or left out"
        assert (stack.occupied[0][piece.slices] & piece.mask).any()
    behind = image.occupied[1:]
    assert (image.disparity[1:] < image.disparity[:-1])[behind].all()


@pytest.mark.parametrize(("saved_bits", "is_kept"), [(215.0, False), (233.0, True)])
def test_a_layer_is_kept_if_it_saves_more_than_its_bits(saved_bits: float, is_kept: bool) -> None:
    """A second layer of the whole frame, without edges: 28 bytes of header, and its code."""
    shape, price = (16, 16), Price(multiplier=2.0, bits_per_pixel=0.5, squared_error=0.0)
    colour, disparity = np.zeros((2, *shape, 3), np.uint8), np.zeros((2, *shape), np.float32)
    disparity[0] = 4.0
    stack = Stack(canvas_of(shape), colour, disparity, np.ones((2, *shape), np.bool_))
    saved = np.ones((2, *shape)) * price.multiplier * (0.5 + saved_bits / 256)
    scene, _ = select(stack, Kind.LAYERS, Worth(saved, np.ones((2, *shape))), price)
    assert len(scene.pieces) == 1 + is_kept


def test_trials_are_counted_and_odd_scenes_borne() -> None:
    empty = Pieces(canvas_of((12, 20)), Kind.LAYERS, ())
    single = Pieces(canvas_of((12, 20)), Kind.SPRITES, (sprite_of(np.ones((1, 1), np.bool_), 3, 5),))
    for scene in (odd_sprites(), empty, single):
        steps: list[int] = []
        found = encode_best(scene, 900, advance=steps.append)
        assert sum(steps) == MOST_TRIALS
        assert decode(decode_stream(found.encoded.data)).damage is None


def profit_of(mask: np.ndarray, profit: np.ndarray, edge_cost: float) -> float:
    edges = np.count_nonzero(mask[1:] != mask[:-1]) + np.count_nonzero(mask[:, 1:] != mask[:, :-1])
    return float(profit[mask].sum() - edge_cost * edges)


@pytest.mark.parametrize("seed", range(5))
def test_masks_are_nearly_the_best(seed: int) -> None:
    """Of all 4096 masks of 3 x 4 pixels."""
    profit = np.random.default_rng(seed).normal(0.2, 2.0, (3, 4))
    mask = best_mask(profit, 0.7, 0.0)
    masks = (np.arange(1 << 12)[:, None] >> np.arange(12) & 1).astype(np.bool_).reshape(-1, 3, 4)
    best = max(profit_of(one, profit, 0.7) for one in masks)
    assert profit_of(mask, profit, 0.7) > 0.75 * best


def test_specks_are_left_out_and_pinholes_closed() -> None:
    profit = np.full((20, 30), -0.5)
    profit[4:14, 5:20] = 3.0
    profit[8, 9] = -0.5
    profit[17, 25] = 3.0
    found = best_mask(profit, 1.0, 0.0)
    assert found[8, 9]
    assert not found[17, 25]
    assert found.sum() == 150
    assert not best_mask(profit, 1.0, 1000.0).any()


def test_what_cannot_be_inside_is_not() -> None:
    profit = np.full((6, 6), 5.0)
    profit[2] = -np.inf
    assert not best_mask(profit, 1.0, 0.0)[2].any()
    assert best_mask(profit, 1.0, 0.0).sum() == 30
    assert not best_mask(-np.abs(profit), 1.0, 0.0).any()


def test_layers_and_their_sprites_are_the_same_stack() -> None:
    layers, sprites = stack_of(plane_layers()), stack_of(plane_sprites())
    np.testing.assert_array_equal(layers.occupied, sprites.occupied)
    np.testing.assert_array_equal(layers.disparity, sprites.disparity)
    np.testing.assert_array_equal(layers.colour, sprites.colour)
    for piece, mask in zip(plane_layers().pieces, layers.occupied, strict=True):
        assert piece.num_values == mask.sum()


def test_nearer_values_lie_before() -> None:
    stack = stack_of(odd_sprites())
    assert stack.occupied.sum() == odd_sprites().num_values
    behind = stack.occupied[1:]
    assert behind.any()
    assert stack.occupied[:-1][behind].all()
    assert (stack.disparity[1:] <= stack.disparity[:-1])[behind].all()


def test_what_the_reference_hides_saves_errors_where_it_is_seen() -> None:
    scene = plane_layers()
    stack = stack_of(scene)
    worth = worth_of(stack, reference_of(stack, Kind.LAYERS), viewpoints_of(scene))
    frame = scene.canvas.frame
    assert worth.seen.sum() <= frame.width * frame.height
    assert worth.seen.sum() == pytest.approx(frame.width * frame.height, rel=0.05)
    assert not worth.saved[~stack.occupied].any()
    inside = worth.saved[0][frame.slices]
    hidden, shown = worth.saved[1:].sum() + worth.saved[0].sum() - inside.sum(), inside.sum()
    assert hidden > 5 * shown


def test_disparities_are_rounded_to_the_labels_that_were_tried() -> None:
    canvas = canvas_of((1, 3), labels=DisparityLabels(-1.0, 0.5, 8))
    disparity = np.array([[[-0.8, 0.3, 0.0]]], np.float32)
    occupied = np.array([[[True, True, False]]])
    rounded = rounded_to_labels(Stack(canvas, np.zeros((1, 1, 3, 3), np.uint8), disparity, occupied))
    np.testing.assert_array_equal(rounded.disparity, np.array([[[-1.0, 0.5, 0.0]]], np.float32))
    np.testing.assert_array_equal(rounded.occupied, occupied)
