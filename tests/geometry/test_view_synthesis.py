"""Rendering of pictures with depth into other views, and filling of their holes."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import (
    PictureWithDepth,
    _along_epipolar_lines,
    fill_from_background,
    synthesise,
)
from dvc.geometry.viewpoints import lattice_warp
from dvc.geometry.warping import EMPTY

ORIGIN = LatticePosition(0.0, 0.0)


def _picture(shape, seed=0):
    levels = np.random.default_rng(seed).integers(40, 216, (*shape, 3))
    return levels.astype(np.uint8)


@pytest.mark.parametrize("shape", [(20, 31), (1, 1), (1, 9), (9, 1)])
def test_own_view_is_the_picture(shape):
    image = _picture(shape)
    depth = np.random.default_rng(1).integers(0, 9, shape).astype(np.float64)
    view = synthesise([PictureWithDepth(image, depth, lattice_warp(ORIGIN, ORIGIN))], shape)
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


def test_nothing_seen_is_black():
    warp = lattice_warp(ORIGIN, LatticePosition(1.0, 0.0))
    view = synthesise([PictureWithDepth(_picture((8, 8)), np.full((8, 8), 100.0), warp)], (8, 8))
    assert not view.drawn.any()
    assert not view.image.any()


ALONG_ROWS = np.array([-1.0, 0.0, 0.0])


def _hole(shape, rows, columns, depth):
    depth = np.broadcast_to(np.asarray(depth, np.float64), shape).copy()
    depth[rows, columns] = EMPTY
    return depth


def test_without_holes_or_levels_nothing_changes():
    image = np.random.default_rng(0).uniform(0, 255, (6, 7, 3))
    for inverse, expected in ((1.0, (image, 1.0)), (EMPTY, (0.0, 0.0))):
        filled, depth = fill_from_background(image, np.full((6, 7), inverse), ALONG_ROWS)
        np.testing.assert_array_equal(filled, np.broadcast_to(expected[0], filled.shape))
        np.testing.assert_array_equal(depth, np.full((6, 7), expected[1]))


def test_a_membrane_continues_a_ramp():
    x, y = np.meshgrid(np.arange(20.0), np.arange(15.0))
    image = (3.0 * x + 2.0 * y)[..., None]
    depth = _hole((15, 20), slice(5, 9), slice(6, 12), 1.0)
    filled, _ = fill_from_background(np.where(depth[..., None] == EMPTY, 0.0, image), depth, ALONG_ROWS)
    np.testing.assert_allclose(filled, image, atol=1e-3)


def test_levels_of_near_surfaces_stay_out():
    image = np.full((12, 30, 1), 10.0)
    image[:, 20:] = 200.0
    depth = _hole((12, 30), slice(0, 12), slice(12, 20), np.where(np.arange(30) < 20, 1.0, 9.0))
    filled, filled_depth = fill_from_background(image, depth, ALONG_ROWS)
    np.testing.assert_allclose(filled[:, 12:20], 10.0, atol=1e-2)
    np.testing.assert_array_equal(filled_depth[:, 12:20], 1.0)


def test_the_laplace_equation_holds_inside():
    generator = np.random.default_rng(2)
    image = generator.uniform(0, 255, (16, 16, 1))
    filled, _ = fill_from_background(image, _hole((16, 16), slice(4, 12), slice(3, 13), 1.0), ALONG_ROWS)
    plane = filled[..., 0]
    around = plane[3:11, 3:13] + plane[5:13, 3:13] + plane[4:12, 2:12] + plane[4:12, 4:14]
    np.testing.assert_allclose(around, 4.0 * plane[4:12, 3:13], atol=2e-3)


def test_beside_the_frame_all_surfaces_bound_a_hole():
    image = np.full((10, 12, 1), 30.0)
    image[5:] = 220.0
    depth = _hole((10, 12), slice(None), slice(8, 12), np.where(np.arange(10) < 5, 1.0, 9.0)[:, None])
    filled, filled_depth = fill_from_background(image, depth, ALONG_ROWS)
    assert filled[9, 8] > 150.0
    assert filled[0, 8] < 60.0
    expected = np.where(np.arange(10) < 5, 1.0, 9.0)[:, None].repeat(4, axis=1)
    np.testing.assert_array_equal(filled_depth[:, 8:], expected)


def test_epipolar_lines_separate_background_and_object():
    twin = python_twin(_along_epipolar_lines)
    generator = np.random.default_rng(5)
    depth = np.where(generator.random((13, 17)) < 0.4, generator.normal(size=(13, 17)), EMPTY)
    for epipole in ([1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [6.0, 5.0, 1.0], [0.0, 0.0, 0.0]):
        np.testing.assert_array_equal(
            _along_epipolar_lines(depth, np.array(epipole)), twin(depth, np.array(epipole))
        )
    found = np.array(_along_epipolar_lines(depth, ALONG_ROWS))
    y, x = np.argwhere((depth == EMPTY) & (np.abs(np.arange(17) - 8) < 3))[10]
    left, right = depth[y, :x][depth[y, :x] > EMPTY], depth[y, x:][depth[y, x:] > EMPTY]
    assert left.size
    assert right.size
    assert found[0, y, x] == min(left[-1], right[0])
    assert found[1, y, x] == max(left[-1], right[0])
