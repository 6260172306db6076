"""From where a scene is seen as a whole."""

import numpy as np
import pytest

from sfm.mapping.scene_map import MapPiece
from sfm.output.flight_page import overview
from tests.sfm.plane_map import WALL, intrinsics_of, piece_of, pose_at


def test_directions_are_those_of_the_cameras() -> None:
    """Up is against the rows; within the radius are nearly all points and all cameras."""
    piece = piece_of(range(6), 47, 33)
    found = overview(piece)
    assert np.dot(found["up"], [0.0, -1.0, 0.0]) > 0.95
    assert np.dot(found["ahead"], [0.0, 0.0, 1.0]) > 0.95
    assert np.linalg.norm(found["up"]) == pytest.approx(1.0)
    away = np.linalg.norm(piece.points - found["middle"], axis=1)
    assert (away <= found["radius"]).mean() >= 0.75
    assert all(
        np.linalg.norm(-pose[:, :3].T @ pose[:, 3] - found["middle"]) <= found["radius"]
        for pose in piece.poses.values()
    )
    assert 0.5 * WALL < found["depth"] < 1.1 * WALL


def test_a_camera_alone_has_an_overview() -> None:
    """Without points it looks ahead, and odd points do no harm."""
    alone = MapPiece(intrinsics_of(8, 8), {3: pose_at(3)}, np.empty((0, 3)), np.empty((0, 3), np.uint8), {})
    found = overview(alone)
    assert found["radius"] > 0.0
    assert np.isfinite(found["middle"]).all()
    odd = MapPiece(
        intrinsics_of(8, 8), {3: pose_at(3)}, np.full((2, 3), np.nan), np.zeros((2, 3), np.uint8), {}
    )
    assert overview(odd) == found
