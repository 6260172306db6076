"""Figures of maps."""

import numpy as np
import pytest

from benchmarks.mapping import Clip, depth_errors
from sfm.mapping.scene_map import MapPiece


def _piece(depth: np.ndarray) -> MapPiece:
    return MapPiece(np.eye(3), {0: np.eye(3, 4)}, np.empty((0, 3)), np.empty((0, 3), np.uint8), {0: depth})


def test_depth_is_compared_in_one_scale() -> None:
    """The unit of the map does not count; what is not known is wrong, and what has no truth is left out."""
    true = np.full((10, 10), 2.0, np.float32)
    true[0] = np.inf
    own = 7.0 * true
    own[0] = 1.0
    own[1] *= 1.1
    own[2] = np.nan
    errors = depth_errors(_piece(own), Clip([], {}, {0: true}))
    assert errors["depth_median_error"] == pytest.approx(0.0, abs=1e-6)
    assert errors["depth_share_close"] == pytest.approx(7 / 9)
    assert errors["depth_share_known"] == pytest.approx(8 / 9)


def test_without_common_frames_there_are_no_figures() -> None:
    """Nothing is made up."""
    assert depth_errors(_piece(np.ones((4, 4), np.float32)), Clip([], {}, {})) == {}
