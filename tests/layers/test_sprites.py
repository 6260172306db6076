"""Sprites with depth: the transitions of (2.22), and properties of any cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.geometry.camera_array import DisparityLabels
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.layers.sprites import JUMP, SpriteSettings, composite, extract_sprites, fused_mask
from tests.stereo.plane_scenes import LABELS, SCENE, Plane, reconstruction_of, square_lattice


def random_layers(seed: int, num_labels: int, shape: tuple[int, int] = (12, 15)) -> LayeredDepthImage:
    """Return layers of random blocks, some of them of single pixels."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 6))
    blocks = rng.integers(0, num_labels, (3, *shape)).repeat(size, axis=1).repeat(size, axis=2)
    disparity = np.sort(blocks[:, : shape[0], : shape[1]], axis=0)[::-1].astype(np.float32)
    votes = np.ones(disparity.shape, np.uint8)
    votes[1:][disparity[1:] >= disparity[:-1]] = 0
    votes = np.minimum.accumulate(votes, axis=0)
    votes[:, rng.random(shape) < 0.05] = 0
    colour = rng.integers(0, 256, (*votes.shape, 3)).astype(np.uint8) * (votes > 0)[..., None]
    labels = DisparityLabels(0.0, 1.0, num_labels)
    canvas = Canvas(shape, Frame(1, 2, shape[1] - 3, shape[0] - 2), labels, 1.0, "middle", 3)
    return LayeredDepthImage(canvas, colour.astype(np.uint8), disparity * (votes > 0), votes)


@given(seed=st.integers(0, 2**32 - 1), num_labels=st.integers(3, 9))
def test_each_value_is_in_exactly_one_sprite(seed: int, num_labels: int) -> None:
    image = random_layers(seed, num_labels)
    sprites = extract_sprites(image)
    found = np.zeros(image.votes.shape, np.int64)
    for sprite in sprites.sprites:
        for row, column in np.argwhere(sprite.mask):
            y, x = row + sprite.top, column + sprite.left
            same = image.occupied[:, y, x] & (image.disparity[:, y, x] == sprite.disparity[row, column])
            assert same.sum() == 1
            layer = same.argmax()
            assert (image.colour[layer, y, x] == sprite.colour[row, column]).all()
            found[layer, y, x] += 1
    np.testing.assert_array_equal(found, image.occupied)
    colour, disparity, mask = composite(sprites)
    np.testing.assert_array_equal(mask, image.occupied[0])
    np.testing.assert_array_equal(colour, image.colour[0])
    np.testing.assert_array_equal(disparity, image.disparity[0])


def test_scene_of_planes() -> None:
    reconstruction = reconstruction_of(SCENE, square_lattice(2), LABELS, (64, 90))
    image = layered_depth_image(reconstruction)
    sprites = extract_sprites(image)
    assert [set(sprite.disparity[sprite.mask]) for sprite in sprites.sprites] == [{2.0}, {6.0}, {10.0}]
    table = sprites.sprites[1]
    seen = image.disparity[0] == 6.0
    assert table.num_values == (image.disparity == 6.0).sum() > seen.sum()
    colour, _, _ = composite(sprites)
    np.testing.assert_array_equal(colour[image.canvas.frame.slices], reconstruction.array[0].image)


def test_slanted_surface_is_one_sprite() -> None:
    reconstruction = reconstruction_of((Plane(1.0, slope=0.1),), [(0.0, 0.0)], LABELS)
    surface = reconstruction.surfaces[0].disparity
    np.rint(surface, out=surface)
    sprites = extract_sprites(layered_depth_image(reconstruction))
    assert [sprite.num_values for sprite in sprites.sprites] == [2400]


def test_no_discontinuity_inside_a_sprite_of_two_surfaces() -> None:
    reconstruction = reconstruction_of(SCENE, [(0.0, 0.0)], LABELS)
    for sprite in extract_sprites(layered_depth_image(reconstruction)).sprites:
        for axis in (0, 1):
            step = np.abs(np.diff(sprite.disparity, axis=axis))
            both = np.diff(sprite.mask.astype(int), axis=axis) == 0
            both &= np.minimum.reduce(
                [sprite.mask.take(range(k, k + step.shape[axis]), axis) for k in (0, 1)]
            )
            assert (step[both] <= JUMP).all()


def test_fusion_keeps_to_both_masks() -> None:
    sprite = np.zeros((3, 8))
    alpha = np.zeros((3, 8), np.bool_)
    alpha[:, :3] = True
    layer = np.where(np.arange(8) < 6, 0.0, 5.0) * np.ones((3, 1))
    layer_alpha = np.ones((3, 8), np.bool_)
    layer_alpha[2] = False
    mask = fused_mask(sprite, alpha, layer, layer_alpha)
    expected = alpha | (layer_alpha & (np.arange(8) < 6))
    np.testing.assert_array_equal(mask, expected)


@pytest.mark.parametrize("rho_small", [0.2, 0.5])
def test_small_differences_stop_a_sprite_only_where_they_say_nothing(rho_small: float) -> None:
    depth = np.where(np.arange(6) < 3, 0.0, 1.0)[None]
    alpha = np.zeros((1, 6), np.bool_)
    alpha[0, 0] = True
    mask = fused_mask(depth, alpha, depth, np.ones((1, 6), np.bool_), SpriteSettings(0.02, rho_small))
    assert mask.sum() == (3 if rho_small == 0.5 else 6)


def test_a_discontinuity_holds_against_a_way_round() -> None:
    depth = np.zeros((20, 20))
    depth[:, 10:] = 4.0
    depth[10, 8:12] = [1.0, 2.0, 3.0, 4.0]
    alpha = np.zeros((20, 20), np.bool_)
    alpha[:, :5] = True
    mask = fused_mask(depth, alpha, depth, np.ones((20, 20), np.bool_))
    assert mask[:, :8].all()
    assert not mask[:, 12:].any()
