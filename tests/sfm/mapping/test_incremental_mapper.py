"""Incremental mapping of exact and noisy tracks, and of what cannot be mapped."""

import numpy as np
import pytest

from benchmarks.map_evaluation import trajectory_error
from sfm.mapping.incremental_mapper import map_pieces
from sfm.mapping.sequence_tracks import SequenceTracks, VisiblePoints
from tests.sfm.mapping.moving_camera import FOCAL, HEIGHT, WIDTH, pose_of, scene, tracks_of


def _silent(_: str) -> None:
    pass


def test_a_moving_camera_is_located_in_every_frame() -> None:
    """With the focal length and the trajectory, from tracks with the noise of a good tracker."""
    poses = [pose_of(k) for k in range(24)]
    (piece,) = map_pieces(tracks_of(poses, scene(900), 0.1), _silent)
    assert sorted(piece.poses) == list(range(24))
    assert abs(piece.K[0, 0] / FOCAL - 1.0) < 0.02
    assert trajectory_error(piece.poses, dict(enumerate(poses))).relative < 0.003


def test_a_cut_begins_a_new_piece() -> None:
    poses = [pose_of(k) for k in range(14)]
    first, second = tracks_of(poses, scene(900, 1), 0.05), tracks_of(poses, scene(900, 2), 0.05)
    moved = tuple(VisiblePoints(each.ids + 900, each.positions) for each in second.seen)
    keys = first.key_frames + tuple(14 + key for key in second.key_frames)
    pieces = map_pieces(SequenceTracks(WIDTH, HEIGHT, first.seen + moved, keys, 1800), _silent)
    assert [sorted(piece.poses) for piece in pieces] == [list(range(14)), list(range(14, 28))]


@pytest.mark.parametrize("step", ["turn", "stand"])
def test_no_parallax_no_piece(step: str) -> None:
    turn = 0.02 if step == "turn" else 0.0
    poses = [pose_of(k, step=0.0, turn=turn) for k in range(12)]
    assert map_pieces(tracks_of(poses, scene(), 0.1), _silent) == []
    empty = VisiblePoints(np.empty(0, np.int64), np.empty((0, 2)))
    assert map_pieces(SequenceTracks(WIDTH, HEIGHT, (empty,) * 5, (0, 1, 2, 4), 0), _silent) == []
