"""Views of a map."""

import numpy as np
import pytest

from sfm.mapping.map_evaluation import render_view
from sfm.mapping.scene_map import MapPiece

SHAPE = (16, 20)
K = np.array([[20.0, 0.0, 9.5], [0.0, 20.0, 7.5], [0.0, 0.0, 1.0]])


def _piece(depths: dict[int, np.ndarray]) -> MapPiece:
    poses = {k: np.column_stack([np.eye(3), [-0.1 * k, 0.0, 0.0]]) for k in range(5)}
    return MapPiece(K, poses, np.empty((0, 3)), np.empty((0, 3), np.uint8), depths)


def test_what_has_no_depth_stands_at_infinity() -> None:
    """The sky is shown as a frame has it, not filled from around."""
    depth = np.full(SHAPE, 4.0, np.float32)
    depth[:8] = np.nan
    picture = np.full((*SHAPE, 1), 90, np.uint8)
    picture[:8] = 200
    piece = _piece({0: depth, 4: depth})
    view = render_view(piece, {0: picture, 4: picture}, piece.poses[2])
    assert view.drawn[2:6].all()
    assert view.image[2:6] == pytest.approx(200.0, abs=1.0)
    assert view.image[10:14] == pytest.approx(90.0, abs=1.0)


def test_one_wrong_depth_does_not_cover_what_others_see() -> None:
    """Three frames see a wall, and the fourth has something near before it that is not there."""
    wall, wrong = np.full(SHAPE, 4.0, np.float32), np.full(SHAPE, 4.0, np.float32)
    wrong[4:12, 4:12] = 1.0
    grey, dark = np.full((*SHAPE, 1), 120, np.uint8), np.full((*SHAPE, 1), 20, np.uint8)
    piece = _piece({0: wall, 1: wall, 3: wall, 4: wrong})
    view = render_view(piece, {0: grey, 1: grey, 3: grey, 4: dark}, piece.poses[2])
    assert view.image.min() > 80.0
