"""Depth of two views of a scene of two planes: its estimation, continuation and rendering."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from dvc.geometry.cameras import inverse_depth_range
from dvc.geometry.continuation import CONSISTENT, OCCLUDED, OUTSIDE, DepthMap, Slopes, continue_surfaces
from dvc.geometry.depth_maps import KnownDepth, estimate_depths
from dvc.geometry.plane_sweep import SweepSettings, depth_hypotheses
from dvc.geometry.rendering import OCCLUDED_WEIGHT, fill_holes, render_depth, visibility_weights
from dvc.geometry.warping import EMPTY, warp_grid, warp_matrix
from tests.scenes_3d import render, two_planes

MODEL = two_planes()
FRAME = MODEL.pixel_frame
FIRST, SECOND = (render(position, FRAME)[0] for position in (0.0, 1.0))


def test_depth_is_the_true_one() -> None:
    for view, position in zip(estimate_depths(MODEL.view_pair, FIRST, SECOND), (0.0, 1.0), strict=True):
        scale = np.sqrt(3.0) / np.linalg.norm(np.eye(3)) if position == 0.0 else 1.0
        truth = render(position, FRAME)[1] / scale
        moved, true = (warp_grid(view.to_other, depth) for depth in (view.depth.inverse_depth, truth))
        wrong = np.hypot(*(moved - true)[..., :2].transpose(2, 0, 1)) > 0.5
        assert view.depth.reliable.mean() > 0.6
        assert wrong[view.depth.reliable].mean() < 0.06


def test_hypotheses_cover_the_scene() -> None:
    warp = warp_matrix(MODEL.first_camera, MODEL.second_camera, FRAME)
    known, settings = 1.0 / MODEL.depths, SweepSettings()
    limits = inverse_depth_range(known)
    found = depth_hypotheses(limits, warp, (80, 96), settings)
    assert found.lowest < np.quantile(known, 0.01)
    assert found.lowest + found.step * (found.num_hypotheses - 1) > known.max()
    fine = depth_hypotheses(limits, warp, (80, 96), replace(settings, step_px=0.3))
    assert fine.num_hypotheses == pytest.approx(2 * found.num_hypotheses, abs=3)
    huge = depth_hypotheses(limits, warp, (4000, 4000), settings)
    assert huge.num_hypotheses == 4


def test_known_points_stretch_the_range() -> None:
    far, near = MODEL.view_pair.inverse_depth_ranges[0]
    truth = render(0.0, FRAME)[1]
    in_front = truth > 0.5 * (far + near)
    right = []
    for nearest in (far, near, 100.0 * near):
        depth = _depth_with_point(nearest, (far, 0.5 * (far + near)))
        right.append(np.mean(np.abs(depth - truth)[in_front] < 0.05 * near))
    assert right[0] < 0.2
    assert min(right[1:]) > 0.8


def test_known_points_within_reach_change_nothing() -> None:
    far, near = limits = MODEL.view_pair.inverse_depth_ranges[0]
    margin = SweepSettings().near_margin * (near - far)
    usual = _depth_with_point(near, limits)
    np.testing.assert_array_equal(_depth_with_point(near + 0.9 * margin, limits), usual)
    assert (_depth_with_point(near + 1.1 * margin, limits) != usual).any()


def _depth_with_point(inverse_depth: float, limits: tuple[float, float]) -> NDArray[np.float64]:
    """Estimate the depth of the first view with a known point in a region on which both views agree."""
    usual = estimate_depths(MODEL.view_pair, FIRST, SECOND)
    both = usual[0].depth.reliable & usual[1].depth.reliable
    inside = distance_transform_edt(np.pad(both, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(np.argmax(inside), inside.shape)
    known = KnownDepth(None, np.array([[float(column), float(row)]]), np.array([inverse_depth]))
    pair = replace(MODEL.view_pair, inverse_depth_ranges=(limits, limits))
    return estimate_depths(pair, FIRST, SECOND, (known, known))[0].depth.inverse_depth


def test_rendering_from_the_own_camera_gives_the_own_depth() -> None:
    first, _ = estimate_depths(MODEL.view_pair, FIRST, SECOND)
    rendered = render_depth([first], first.camera, FRAME)
    inside = rendered.reliable & first.depth.reliable
    np.testing.assert_allclose(rendered.inverse_depth[inside], first.depth.inverse_depth[inside], rtol=1e-6)


def test_holes_take_the_depth_behind() -> None:
    depth = np.full((9, 12), 0.2)
    depth[:, 8:] = 0.9
    depth[:, 5:8] = EMPTY
    assert (fill_holes(depth)[:, 5:8] == 0.2).all()
    lonely = np.full((9, 12), EMPTY)
    lonely[0, 1] = 0.4
    assert (fill_holes(lonely) == 0.4).all()
    assert (fill_holes(np.full((3, 3), EMPTY)) == 0.0).all()


def test_occluded_points_have_next_to_no_weight() -> None:
    first, second = estimate_depths(MODEL.view_pair, FIRST, SECOND)
    weights = visibility_weights(second, warp_grid(first.to_other, first.depth.inverse_depth))
    outside = first.depth.visibility == OUTSIDE
    assert outside.any()
    assert weights[outside].max() < OCCLUDED_WEIGHT
    assert (weights[first.depth.reliable] > OCCLUDED_WEIGHT).mean() > 0.95


def test_slopes_end_beyond_their_reach() -> None:
    shape = 30, 40
    column = np.indices(shape)[1]
    plane = 0.3 + 0.004 * column
    visibility = np.where(column < 15, CONSISTENT, OCCLUDED).astype(np.int8)
    away = np.eye(3, 4)
    away[0, 3] = 1000.0
    unseen = DepthMap(np.zeros(shape), np.full(shape, OCCLUDED, np.int8))
    luma, slopes = np.full(shape, 90.0), Slopes(6, 0.1, 5.0)
    filled = continue_surfaces(DepthMap(plane, visibility), luma, unseen, (away, away), slopes, 1.0)
    assert filled[5, 16] - filled[5, 14] > 0.006
    assert filled[:, 15:].max() <= plane[0, 14] + 5.0 * 0.004 + 1e-9
