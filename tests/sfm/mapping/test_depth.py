"""Dense depth of views with known cameras."""

import numpy as np
import pytest

from dvc.geometry.cameras import PixelFrame
from sfm.mapping.dense import points_in_world
from sfm.mapping.keyframe_depth import View, complete_depths, inverse_depth_span, neighbours, sweep_depth
from tests.scenes_3d import camera_at, render

SIZE = PixelFrame(96, 80)
K = np.array([[96.0, 0.0, 47.5], [0.0, 96.0, 39.5], [0.0, 0.0, 1.0]])


def _views(positions: list[float]) -> tuple[dict[int, View], dict[int, np.ndarray]]:
    views, depths = {}, {}
    for k, position in enumerate(positions):
        camera = camera_at(position)
        pose = camera / np.cbrt(np.linalg.det(camera[:, :3]))
        luma, inverse = render(position, SIZE)
        depths[k] = 1.0 / inverse
        points, _ = points_in_world(depths[k][::8, ::8].astype(np.float32), _sparse_K(), pose)
        views[k] = View(luma, K, pose, points)
    return views, depths


def _sparse_K() -> np.ndarray:
    sparse = K / 8.0
    sparse[2, 2] = 1.0
    return sparse


def test_depth_of_exact_cameras() -> None:
    """Nearly everywhere within a few per cent, in the unit of the cameras."""
    views, true = _views([0.0, 0.5, 1.0, 1.5])
    nearest = max(inverse_depth_span(view)[1] for view in views.values())
    swept = {k: found for k in views if (found := sweep_depth(views, k, nearest)) is not None}
    completed = complete_depths(views, swept)
    assert sorted(completed) == [0, 1, 2, 3]
    ratio = np.concatenate([(completed[k] / true[k]).ravel() for k in completed])
    ratio /= np.median(ratio)
    assert np.nanmedian(np.abs(ratio - 1.0)) < 0.02
    assert np.mean(np.abs(ratio - 1.0) < 0.05) > 0.85


def test_neighbours_lie_on_both_sides() -> None:
    """As far as there are frames, and the frame itself is none of them."""
    views, _ = _views([0.0, 0.5, 1.0, 1.5, 2.0])
    chosen = neighbours(views, 2)
    assert 2 not in chosen
    assert min(chosen) < 2 < max(chosen)


@pytest.mark.parametrize("positions", [[0.0], [0.0, 0.0]])
def test_without_baseline_there_is_no_depth(positions: list[float]) -> None:
    """A frame alone, or a camera that stands still, says nothing."""
    views, _ = _views(positions)
    assert sweep_depth(views, 0, 1.0) is None
