"""Values of pieces sorted by pixel, and what they are worth."""

import numpy as np
import pytest

from dvc.dibr.depth_image.scene_pieces import Kind
from dvc.dibr.layered.simplification import alone
from dvc.dibr.layered.stack import Stack, rounded_to_labels, stack_of, viewpoints_of, worth_of
from dvc.geometry.camera_array import DisparityLabels
from tests.dibr.piece_scenes import canvas_of, odd_sprites, plane_layers, plane_sprites


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
    worth = worth_of(stack, alone(stack, Kind.LAYERS), viewpoints_of(scene))
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
