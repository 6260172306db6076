"""Levels of what no picture shows."""

import numpy as np

from dvc.multiview.hole_filling import fill_from_background
from dvc.multiview.rendering import EMPTY


def _hole(shape, rows, columns, depth):
    depth = np.broadcast_to(np.asarray(depth, np.float64), shape).copy()
    depth[rows, columns] = EMPTY
    return depth


def test_without_holes_nothing_changes():
    image = np.random.default_rng(0).uniform(0, 255, (6, 7, 3))
    filled, depth = fill_from_background(image, np.ones((6, 7)))
    np.testing.assert_array_equal(filled, image)
    np.testing.assert_array_equal(depth, 1.0)


def test_a_membrane_continues_a_ramp():
    x, y = np.meshgrid(np.arange(20.0), np.arange(15.0))
    image = (3.0 * x + 2.0 * y)[..., None]
    depth = _hole((15, 20), slice(5, 9), slice(6, 12), 1.0)
    filled, _ = fill_from_background(np.where(depth[..., None] == EMPTY, 0.0, image), depth)
    np.testing.assert_allclose(filled, image, atol=1e-3)


def test_levels_of_near_surfaces_stay_out():
    image = np.full((12, 30, 1), 10.0)
    image[:, 20:] = 200.0
    depth = _hole((12, 30), slice(0, 12), slice(12, 20), np.where(np.arange(30) < 20, 1.0, 9.0))
    filled, filled_depth = fill_from_background(image, depth)
    np.testing.assert_allclose(filled[:, 12:20], 10.0, atol=1e-2)
    np.testing.assert_array_equal(filled_depth[:, 12:20], 1.0)


def test_a_hole_at_the_border_is_bounded_from_inside():
    image = np.full((9, 9, 2), 77.0)
    filled, _ = fill_from_background(image, _hole((9, 9), slice(None), slice(5, 9), 3.0))
    np.testing.assert_allclose(filled, 77.0, atol=1e-6)


def test_the_laplace_equation_holds_inside():
    generator = np.random.default_rng(2)
    image = generator.uniform(0, 255, (16, 16, 1))
    filled, _ = fill_from_background(image, _hole((16, 16), slice(4, 12), slice(3, 13), 1.0))
    plane = filled[..., 0]
    around = plane[3:11, 3:13] + plane[5:13, 3:13] + plane[4:12, 2:12] + plane[4:12, 4:14]
    np.testing.assert_allclose(around, 4.0 * plane[4:12, 3:13], atol=2e-3)


def test_an_empty_picture_is_black():
    filled, depth = fill_from_background(np.ones((3, 4, 3)), np.full((3, 4), EMPTY))
    assert not filled.any()
    assert not depth.any()
