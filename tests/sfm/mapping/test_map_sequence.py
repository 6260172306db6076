"""Maps of whole sequences, against the exact geometry of a small scene."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.map_evaluation import render_view, trajectory_error
from dvc.geometry.cameras import PixelFrame
from dvc.video import Frame, create_video
from sfm.mapping.map_sequence import map_sequence, map_video, reach_of, write_pictures
from sfm.mapping.scene_map import MapPiece, SceneMap
from tests.scenes_3d import camera_at, render
from tests.sfm.plane_map import map_of, piece_of

SIZE = PixelFrame(192, 144)
POSITIONS = np.linspace(-2.5, 2.5, 17)


@cache
def _clip() -> tuple[list[Frame], list[np.ndarray]]:
    views = [render(position, SIZE) for position in POSITIONS]
    return [Frame(luma) for luma, _ in views], [1.0 / inverse for _, inverse in views]


def _poses() -> dict[int, np.ndarray]:
    cameras = [camera_at(position) for position in POSITIONS]
    return {k: camera / np.cbrt(np.linalg.det(camera[:, :3])) for k, camera in enumerate(cameras)}


@cache
def _map() -> SceneMap:
    return map_sequence(lambda: _clip()[0])


def test_all_frames_are_located() -> None:
    (piece,) = _map().pieces
    assert sorted(piece.poses) == list(range(len(POSITIONS)))
    assert trajectory_error(piece.poses, _poses()).relative < 0.01
    assert abs(piece.intrinsics[0, 0] / SIZE.width_px - 1.0) < 0.2  # little turning: weakly determined
    assert _map().summary == "map: 1 piece, 17 of 17 frames located"


def test_depth_is_that_of_the_scene() -> None:
    """In one scale for all frames; the cloud is as large as the scene, and grey as the frames are."""
    (piece,) = _map().pieces
    ratio = np.stack([depth / _clip()[1][k] for k, depth in piece.depths.items()])
    errors = np.abs(ratio / np.nanmedian(ratio) - 1.0)
    assert len(ratio) >= 3
    assert np.nanmedian(errors) < 0.03
    assert np.mean(errors < 0.05) > 0.8
    assert 3000 < len(piece.points) < 500_000
    assert np.ptp(piece.colours, axis=1).max() == 0


def test_several_frames_render_a_left_out_one() -> None:
    """Better than 30 dB, at the pose that the map has for it."""
    (piece,) = _map().pieces
    frames = _clip()[0]
    wanted = next(k for k in piece.poses if k not in piece.depths)
    pictures = {k: frames[k].luma[:, :, None] for k in piece.depths}
    view = render_view(piece, pictures, piece.poses[wanted])
    error = (view.image[:, :, 0] - frames[wanted].luma)[8:-8, 8:-8]
    assert 10 * np.log10(255**2 / np.mean(error**2)) > 30


def test_a_video_gives_the_map_of_its_frames(tmp_path: Path) -> None:
    path, lines = str(tmp_path / "clip.mkv"), []
    with create_video(path, (SIZE.width_px, SIZE.height_px), 25) as writer:
        for frame in _clip()[0]:
            writer.write(frame)
    found = map_video(path, report=lines.append)
    assert found.num_located == len(POSITIONS)
    np.testing.assert_allclose(found.pieces[0].poses[9], _map().pieces[0].poses[9], atol=1e-6)
    assert lines[0] == "tracking points"
    assert any(line.startswith("depth") for line in lines)


@pytest.mark.parametrize("kind", ["none", "one", "black", "still"])
def test_what_shows_no_scene_has_no_piece(kind: str) -> None:
    black, first = Frame(np.full((144, 192), 16, np.uint8)), _clip()[0][0]
    frames = {"none": [], "one": [first], "black": [black] * 4, "still": [first] * 6}[kind]
    found = map_sequence(lambda: frames)
    assert found.pieces == ()
    assert found.num_frames == len(frames)


def test_mappers_have_names() -> None:
    with pytest.raises(ValueError, match="mapper"):
        map_sequence(lambda: [], mapper="other")


def test_colmap_maps_the_scene() -> None:
    found = map_sequence(lambda: _clip()[0], mapper="colmap")
    (piece,) = found.pieces
    assert len(piece.poses) >= 0.9 * len(POSITIONS)
    assert trajectory_error(piece.poses, _poses()).relative < 0.1  # pictures this small have few features
    assert len(piece.depths) >= 3


@pytest.mark.parametrize(
    ("first", "last", "reach"),
    [(8, 12, range(5, 21)), (0, 30, range(31)), (3, 20, range(2, 31)), (21, 29, range(20, 31))],
)
def test_pieces_reach_to_the_key_frames_around(first: int, last: int, reach: range) -> None:
    assert reach_of([0, 2, 5, 20, 30], first, last) == reach


def test_pictures_that_cannot_be_written_are_an_error(tmp_path: Path) -> None:
    frames = [Frame(np.full((8, 8), level, np.uint8)) for level in (10, 20)]
    assert write_pictures(tmp_path, frames, [1]) == ["00000001.png"]
    with pytest.raises(OSError, match="No such file"):
        write_pictures(tmp_path / "nowhere", frames, [1])


@pytest.mark.parametrize(
    ("pieces", "summary"),
    [
        ((), "map: no frame of 12 located: few points, or no parallax"),
        ((piece_of(range(5), 12, 9),), "map: 1 piece, 5 of 12 frames located"),
        (
            (piece_of(range(5), 12, 9), piece_of(range(7, 12), 12, 9)),
            "map: 2 pieces, 10 of 12 frames located",
        ),
    ],
)
def test_summary_counts_pieces_and_frames(pieces: tuple[MapPiece, ...], summary: str) -> None:
    assert map_of(*pieces, size=(12, 9)).summary == summary
