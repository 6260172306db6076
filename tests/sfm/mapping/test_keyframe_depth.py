"""Dense depth of views with known cameras, and fusion of depth maps."""

import numpy as np
import pytest

from dvc.geometry.cameras import PixelFrame
from dvc.geometry.depth_maps import MIN_CONFIDENCE
from sfm.mapping.dense import points_in_world
from sfm.mapping.keyframe_depth import (
    Candidate,
    SweptDepth,
    View,
    complete_depths,
    drawn_candidate,
    fused_depth,
    inverse_depth_span,
    neighbours,
    sweep_depth,
)
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


SHAPE = (6, 8)


def _swept(inverse_depth: float, error: float = 0.01) -> SweptDepth:
    return SweptDepth(np.full(SHAPE, inverse_depth), np.full(SHAPE, 2.0 * MIN_CONFIDENCE), error)


def _candidate(inverse_depth: float, error: float = 0.01) -> Candidate:
    return Candidate(np.full(SHAPE, inverse_depth), np.full(SHAPE, error))


def test_the_majority_takes_the_place_of_a_depth_that_is_not_consistent() -> None:
    """Two that agree against the frame alone."""
    depth, votes = fused_depth(
        _swept(0.5), [_candidate(0.2), _candidate(0.21), _candidate(np.nan)], np.zeros(SHAPE, bool)
    )
    assert depth == pytest.approx(0.205)
    assert (votes == 2).all()


def test_a_consistent_depth_stays() -> None:
    """What disagrees does not count, whatever its number; what agrees is averaged by its error."""
    others = [_candidate(0.2), _candidate(0.2), _candidate(0.2), _candidate(0.515, 0.005)]
    depth, votes = fused_depth(_swept(0.5), others, np.ones(SHAPE, bool))
    assert depth == pytest.approx((0.5 + 4.0 * 0.515) / 5.0)
    assert (votes == 2).all()


def test_alone_a_candidate_does_not_count() -> None:
    """The frame keeps what it has."""
    depth, votes = fused_depth(_swept(0.5), [_candidate(0.2)], np.zeros(SHAPE, bool))
    assert depth == pytest.approx(0.5)
    assert (votes == 1).all()


def test_of_equal_votes_the_smaller_error_wins() -> None:
    """Two pairs: the one that is known better counts."""
    others = [_candidate(0.51), _candidate(0.2, 0.002), _candidate(0.2, 0.002)]
    depth, _ = fused_depth(_swept(0.5), others, np.zeros(SHAPE, bool))
    assert depth == pytest.approx(0.2)


def test_a_nearer_frame_knows_depth_better() -> None:
    """A camera stands a unit behind another: what that one sees at depth 1 is at depth 2 here."""
    back = np.column_stack([np.eye(3), [3.5, 2.5, 1.0]])  # the epipole is the middle of the picture
    found = drawn_candidate(_swept(1.0), back)
    seen = np.isfinite(found.inverse_depth)
    assert 0 < seen.sum() < seen.size
    assert found.inverse_depth[seen] == pytest.approx(0.5)
    assert found.error[seen] == pytest.approx(0.0025)


def test_what_is_not_confident_is_no_candidate() -> None:
    """Where noise would have done the same nothing is drawn."""
    doubtful = SweptDepth(np.full(SHAPE, 1.0), np.zeros(SHAPE), 0.01)
    assert np.isnan(drawn_candidate(doubtful, np.eye(3, 4)).inverse_depth).all()
