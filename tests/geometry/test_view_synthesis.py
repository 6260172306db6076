"""Rendering of pictures with depth into other views."""

import numpy as np
import pytest

from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import PictureWithDepth, synthesise
from dvc.geometry.viewpoints import lattice_warp

ORIGIN = LatticePosition(0.0, 0.0)


def _picture(shape, seed=0):
    levels = np.random.default_rng(seed).integers(40, 216, (*shape, 3))
    return levels.astype(np.uint8)


def test_own_view_is_the_picture():
    image = _picture((20, 31))
    depth = np.random.default_rng(1).integers(0, 9, (20, 31)).astype(np.float64)
    view = synthesise([PictureWithDepth(image, depth, lattice_warp(ORIGIN, ORIGIN))], (20, 31))
    assert view.drawn.all()
    np.testing.assert_allclose(view.image, image, atol=1e-9)
    np.testing.assert_array_equal(view.inverse_depth, depth)


@pytest.mark.parametrize(("m", "n"), [(1.0, 0.0), (0.0, -1.0), (2.0, 1.0)])
def test_constant_disparity_is_a_shift(m, n):
    image = _picture((24, 24))
    warp = lattice_warp(ORIGIN, LatticePosition(m, n))
    view = synthesise([PictureWithDepth(image, np.full((24, 24), 3.0), warp)], (24, 24))
    dx, dy = round(-3 * m), round(-3 * n)
    shifted = np.roll(image, (dy, dx), axis=(0, 1)).astype(np.float64)
    seen = np.zeros((24, 24), bool)
    seen[max(dy, 0) : 24 + min(dy, 0), max(dx, 0) : 24 + min(dx, 0)] = True
    np.testing.assert_array_equal(view.drawn, seen)
    np.testing.assert_allclose(view.image[seen], shifted[seen], atol=1e-9)


def test_near_surface_covers_far_one_and_the_hole_takes_the_background():
    image = np.full((30, 40, 3), 50, np.uint8)
    depth = np.full((30, 40), 1.0)
    image[10:20, 15:25], depth[10:20, 15:25] = 200, 6.0
    warp = lattice_warp(ORIGIN, LatticePosition(1.0, 0.0))
    view = synthesise([PictureWithDepth(image, depth, warp)], (30, 40))
    assert (view.image[12:18, 10:18] > 190).all()
    np.testing.assert_array_equal(view.inverse_depth[12:18, 10:18], 6.0)
    hole = ~view.drawn[15, 19:24]
    assert hole.sum() >= 4
    # the cubic filter rings a little beside the object, as it does in any picture
    np.testing.assert_allclose(view.image[15, 20:23], 50.0, atol=12.0)
    np.testing.assert_allclose(view.inverse_depth[15, 20:23], 1.0)


def test_a_slope_in_whole_steps_is_one_surface():
    columns = np.arange(60)
    depth = np.broadcast_to(np.floor(columns / 4.0), (20, 60)).astype(np.float64)
    warp = lattice_warp(ORIGIN, LatticePosition(-3.0, 0.0))
    torn = synthesise([PictureWithDepth(_picture((20, 60)), depth, warp)], (20, 60))
    whole = synthesise([PictureWithDepth(_picture((20, 60)), depth, warp, step=1.0)], (20, 60))
    assert not torn.drawn[10].all()
    assert whole.drawn.all()


def test_a_second_source_shows_what_the_first_does_not():
    depth = np.full((16, 32), 4.0)
    left = PictureWithDepth(_picture((16, 32)), depth, lattice_warp(LatticePosition(-1.0, 0.0), ORIGIN))
    right = PictureWithDepth(_picture((16, 32), 1), depth, lattice_warp(LatticePosition(1.0, 0.0), ORIGIN))
    view = synthesise([left, right], (16, 32))
    assert view.drawn.all()
    both = 0.5 * (np.roll(left.image, -4, axis=1).astype(float) + np.roll(right.image, 4, axis=1))
    np.testing.assert_allclose(view.image[:, 4:28], both[:, 4:28], atol=1e-9)
    second = synthesise([left, right._replace(weight=0.0)], (16, 32))
    np.testing.assert_allclose(second.image[:, 4:28], np.roll(left.image, -4, axis=1)[:, 4:28], atol=1e-3)
    np.testing.assert_allclose(second.image[:, 28:], np.roll(right.image, 4, axis=1)[:, 28:], atol=1e-3)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_pictures_of_one_row_or_column(shape):
    image = _picture(shape)
    view = synthesise([PictureWithDepth(image, np.zeros(shape), lattice_warp(ORIGIN, ORIGIN))], shape)
    np.testing.assert_allclose(view.image, image, atol=1e-9)


def test_nothing_seen_is_black():
    warp = lattice_warp(ORIGIN, LatticePosition(1.0, 0.0))
    view = synthesise([PictureWithDepth(_picture((8, 8)), np.full((8, 8), 100.0), warp)], (8, 8))
    assert not view.drawn.any()
    assert not view.image.any()
