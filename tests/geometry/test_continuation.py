"""Continuation of reliable surfaces over the rest of a view, for any two cameras."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.continuation import SeenDepth, Slopes, Visibility, continue_surfaces

SHAPE = (30, 40)
STAY = np.eye(3, 4)
AWAY = np.eye(3, 4)
AWAY[0, 3] = 1000.0
LUMA = np.full(SHAPE, 90.0)
SLOPES = Slopes(6, 0.1, 40.0)


def states(reliable: NDArray[np.bool_]) -> NDArray[np.int8]:
    return np.where(reliable, Visibility.CONSISTENT, Visibility.OCCLUDED).astype(np.int8)


def test_planes_are_continued_and_what_is_reliable_stays() -> None:
    rows, columns = np.indices(SHAPE)
    plane = 0.3 + 0.004 * columns - 0.003 * rows
    reliable = np.ones(SHAPE, bool)
    reliable[10:18, 12:24] = False
    damaged = np.where(reliable, plane, 7.0)
    elsewhere = SeenDepth(np.zeros(SHAPE), np.full(SHAPE, Visibility.OCCLUDED, np.int8))
    own = SeenDepth(damaged, states(reliable))
    found = continue_surfaces(own, LUMA, elsewhere, (AWAY, AWAY), SLOPES, 1.0)
    np.testing.assert_allclose(found, plane, atol=1e-6)
    np.testing.assert_array_equal(found[reliable], plane[reliable])
    assert damaged[14, 14] == 7.0, "the input stays"


def test_beyond_their_reach_slopes_end() -> None:
    plane = 0.3 + 0.004 * np.indices(SHAPE)[1]
    reliable = np.indices(SHAPE)[1] < 15
    elsewhere = SeenDepth(np.zeros(SHAPE), np.full(SHAPE, Visibility.OCCLUDED, np.int8))
    near = Slopes(6, 0.1, 5.0)
    found = continue_surfaces(SeenDepth(plane, states(reliable)), LUMA, elsewhere, (AWAY, AWAY), near, 1.0)
    assert found[5, 16] - found[5, 14] > 0.006
    assert found[:, 15:].max() <= plane[0, 14] + 5.0 * 0.004 + 1e-9


def test_other_view_looks_through() -> None:
    near, far = 0.8, 0.1
    reliable = np.ones(SHAPE, bool)
    reliable[:, 15:25] = False
    depth = np.where(np.indices(SHAPE)[1] < 20, far, near)
    moved = np.eye(3, 4)
    moved[0, 3] = 10.0
    back = np.eye(3, 4)
    back[0, 3] = -10.0
    other = SeenDepth(np.full(SHAPE, far), np.full(SHAPE, Visibility.CONSISTENT, np.int8))
    own = SeenDepth(depth, states(reliable))
    found = continue_surfaces(own, LUMA, other, (moved, back), Slopes(3, 0.05, 0.0), 0.5)
    np.testing.assert_allclose(found[:, 15:25], far)
    stay = continue_surfaces(own, LUMA, SeenDepth(depth, states(~reliable)), (STAY, STAY), SLOPES, 0.5)
    assert stay[:, 15:25].max() > 0.5
