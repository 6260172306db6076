"""Errors of rendered views."""

import numpy as np
import pytest

from dvc.dibr.view_encoder import ForwardErrors, parallax_px
from dvc.dibr.view_set import Views
from dvc.geometry.camera_array import DisparityLabels, LatticePosition

SHAPE, SHIFT = (24, 32), 3
LABELS = DisparityLabels(0.0, 1.0, 6)
HERE, RIGHT = LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)


def shifted_views() -> Views:
    """Return two views of a plane in a texture, at disparity `SHIFT`."""
    rng = np.random.default_rng(0)
    wall = rng.integers(0, 256, (SHAPE[0], SHAPE[1] + SHIFT)).astype(np.uint8)
    left, right = wall[:, : SHAPE[1]].copy(), wall[:, SHIFT:].copy()
    return Views((left, right), (HERE, RIGHT))


def test_errors_are_those_of_holes_where_the_rest_is_right() -> None:
    """With the true disparities, all errors are in the strip that the reference does not see."""
    views = shifted_views()
    errors = ForwardErrors(views.pictures[0], HERE, LABELS, [(views.pictures[1], RIGHT)])
    total, (holes,) = errors.measure(np.full(SHAPE, SHIFT, np.int32))
    assert not holes.errors[:, :-SHIFT].any()
    assert holes.errors[:, -SHIFT:].any()
    assert total == pytest.approx(float(holes.errors.sum()) / 2.0, rel=1e-5)
    np.testing.assert_array_equal(holes.first_label[:, :-SHIFT], SHIFT - 1)  # 1.5 labels behind, rounded up
    np.testing.assert_array_equal(holes.first_label[:, -SHIFT:], 0)
    assert errors.parallax == pytest.approx(0.5)
    assert errors.measure(np.zeros(SHAPE, np.int32))[0] > 2.0 * total


def test_labels_that_lead_into_holes_are_credited() -> None:
    """The last pixel of a row reaches the hole by labels below the true one."""
    views = shifted_views()
    errors = ForwardErrors(views.pictures[0], HERE, LABELS, [(views.pictures[1], RIGHT)])
    holes = errors.measure(np.full(SHAPE, SHIFT, np.int32))[1]
    tensor = np.ones((*SHAPE, LABELS.num_labels), np.float32)
    credited = errors.claimed(tensor, holes, 0.5)
    expected = 1.0 - 0.25 * holes[0].errors[:, ::-1][:, :SHIFT]
    np.testing.assert_allclose(credited[:, -1, :SHIFT], expected, rtol=1e-5)
    np.testing.assert_array_equal(credited[:, -1, SHIFT:], 1.0)
    covered = [hole._replace(first_label=np.full(SHAPE, 2, np.int32)) for hole in holes]
    hidden = errors.claimed(tensor, covered, 0.5)
    np.testing.assert_array_equal(hidden[..., :2], 1.0)
    np.testing.assert_array_equal(hidden[..., 2:], credited[..., 2:])


def test_parallax_is_that_of_the_middle() -> None:
    """From one label to the next, in a view that is turned, where it is not the same everywhere."""
    warp = np.array([[1.0, 0.0, 0.0, 3.0], [0.0, 1.0, 0.0, 4.0], [0.01, 0.02, 1.0, 0.0]])
    found = parallax_px(warp, (21, 41), np.array([0.0, 1.0, 2.0]))
    assert found == pytest.approx(5.0 / (0.01 * 20.0 + 0.02 * 10.0 + 1.0))


def test_parallax_of_one_label_is_none() -> None:
    """Where nothing can move nothing does."""
    assert parallax_px(np.eye(3, 4), SHAPE, np.array([2.0])) == 0.0
