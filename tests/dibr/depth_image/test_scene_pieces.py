"""Pieces: near over far, hidden surfaces come to light, the reference view comes back; bounds."""

from functools import cache

import numpy as np
import pytest

from dvc.dibr.depth_image.piece_selection import reference_of, stack_of
from dvc.dibr.depth_image.scene_pieces import ACROSS, BEYOND, bounds_around, bounds_of_one, render_pieces
from dvc.dibr.view_rendering import PictureAndDisparity, picture_of, render_pairs
from dvc.geometry.camera_array import LatticePosition, Reconstruction
from tests.dibr.piece_scenes import plane_layers, plane_sprites
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice


def test_bounds_are_beyond_all_sides() -> None:
    beyond = 4 * BEYOND
    assert bounds_around(-1.0, 3.0, 0.0, 1.0) == (-1 - beyond, 3 + beyond, -beyond, 1 + beyond)
    assert bounds_around(0.0, 1.0, 2.0, 5.0) == (-3 * BEYOND, 1 + 3 * BEYOND, 2 - 3 * BEYOND, 5 + 3 * BEYOND)
    assert bounds_of_one(200, 5.0) == pytest.approx([-40 * ACROSS, 40 * ACROSS] * 2)


SCENES = {"layers": plane_layers(), "sprites": plane_sprites()}


@cache
def reconstruction() -> Reconstruction:
    """Surfaces of nine cameras, made once."""
    return reconstruction_of(SCENE, square_lattice(1), LABELS)


def mse(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.mean((one.astype(float) - other) ** 2))


@pytest.mark.parametrize("name", SCENES)
def test_the_reference_view_comes_back(name: str) -> None:
    view = render_pieces(SCENES[name], LatticePosition(0.0, 0.0))
    assert view.drawn.all()
    reference = reconstruction().array[reconstruction().array.reference].image
    np.testing.assert_array_equal(picture_of(view), reference)


@pytest.mark.parametrize("position", [(0.0, 0.0), (0.5, 0.0), (-1.0, 0.25), (0.3, 1.0)])
def test_a_piece_that_is_all_of_the_frame_is_drawn_like_a_picture(position: tuple[float, float]) -> None:
    scene = SCENES["layers"]
    front = reference_of(stack_of(scene), scene.kind)
    (piece,) = front.pieces
    pair = PictureAndDisparity(piece.colour, piece.disparity.astype(float), LatticePosition(0.0, 0.0))
    view = render_pieces(front, LatticePosition(*position))
    expected = render_pairs([pair], LatticePosition(*position), scene.canvas.resolution)
    np.testing.assert_array_equal(view.drawn, expected.drawn)
    np.testing.assert_allclose(view.image, expected.image, atol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_views_beside_show_what_the_reference_does_not(name: str) -> None:
    middle = reconstruction().array.reference
    pair = PictureAndDisparity(
        reconstruction().array[middle].image,
        reconstruction().surfaces[middle].disparity.astype(float),
        LatticePosition(0.0, 0.0),
    )
    for number in range(1, 5):
        camera = reconstruction().array[number]
        view = render_pieces(SCENES[name], camera.position)
        assert view.drawn.mean() > 0.99
        reference_of = render_pairs([pair], camera.position, 1.0)
        assert reference_of.drawn.mean() < view.drawn.mean()
        assert mse(picture_of(view), camera.image) < 0.3 * mse(picture_of(reference_of), camera.image)
