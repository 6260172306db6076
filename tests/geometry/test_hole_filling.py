"""Levels of what no picture shows."""

import numpy as np

from dvc._jit import python_twin
from dvc.geometry.view_synthesis import _along_epipolar_lines, fill_from_background
from dvc.geometry.warping import EMPTY

ALONG_ROWS = np.array([-1.0, 0.0, 0.0])


def _hole(shape, rows, columns, depth):
    depth = np.broadcast_to(np.asarray(depth, np.float64), shape).copy()
    depth[rows, columns] = EMPTY
    return depth


def test_without_holes_nothing_changes():
    image = np.random.default_rng(0).uniform(0, 255, (6, 7, 3))
    filled, depth = fill_from_background(image, np.ones((6, 7)), ALONG_ROWS)
    np.testing.assert_array_equal(filled, image)
    np.testing.assert_array_equal(depth, 1.0)


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


def test_a_hole_at_the_border_is_bounded_from_inside():
    image = np.full((9, 9, 2), 77.0)
    filled, _ = fill_from_background(image, _hole((9, 9), slice(None), slice(5, 9), 3.0), ALONG_ROWS)
    np.testing.assert_allclose(filled, 77.0, atol=1e-6)


def test_the_laplace_equation_holds_inside():
    generator = np.random.default_rng(2)
    image = generator.uniform(0, 255, (16, 16, 1))
    filled, _ = fill_from_background(image, _hole((16, 16), slice(4, 12), slice(3, 13), 1.0), ALONG_ROWS)
    plane = filled[..., 0]
    around = plane[3:11, 3:13] + plane[5:13, 3:13] + plane[4:12, 2:12] + plane[4:12, 4:14]
    np.testing.assert_allclose(around, 4.0 * plane[4:12, 3:13], atol=2e-3)


def test_an_empty_picture_is_black():
    filled, depth = fill_from_background(np.ones((3, 4, 3)), np.full((3, 4), EMPTY), ALONG_ROWS)
    assert not filled.any()
    assert not depth.any()


def test_beside_the_frame_all_surfaces_bound_a_hole():
    image = np.full((10, 12, 1), 30.0)
    image[5:] = 220.0
    depth = _hole((10, 12), slice(None), slice(8, 12), np.where(np.arange(10) < 5, 1.0, 9.0)[:, None])
    filled, filled_depth = fill_from_background(image, depth, ALONG_ROWS)
    assert filled[9, 8] > 150.0
    assert filled[0, 8] < 60.0
    expected = np.where(np.arange(10) < 5, 1.0, 9.0)[:, None].repeat(4, axis=1)
    np.testing.assert_array_equal(filled_depth[:, 8:], expected)


def test_epipolar_lines_tell_background_from_object():
    twin = python_twin(_along_epipolar_lines)
    generator = np.random.default_rng(5)
    depth = np.where(generator.random((13, 17)) < 0.4, generator.normal(size=(13, 17)), EMPTY)
    for epipole in ([1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [6.0, 5.0, 1.0], [0.0, 0.0, 0.0]):
        found, expected = np.empty((2, 13, 17)), np.empty((2, 13, 17))
        _along_epipolar_lines(depth, np.array(epipole), *found)
        twin(depth, np.array(epipole), *expected)
        np.testing.assert_array_equal(found, expected)
    _along_epipolar_lines(depth, ALONG_ROWS, *found)
    y, x = np.argwhere((depth == EMPTY) & (np.abs(np.arange(17) - 8) < 3))[10]
    left, right = depth[y, :x][depth[y, :x] > EMPTY], depth[y, x:][depth[y, x:] > EMPTY]
    assert left.size
    assert right.size
    assert found[0, y, x] == min(left[-1], right[0])
    assert found[1, y, x] == max(left[-1], right[0])
