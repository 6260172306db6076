"""Figures of maps."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.mapping import Clip, depth_errors, every, line, main, true_depth, view_quality
from dvc.video import Frame
from sequences.rendered_sequence import RenderedSequence
from sfm.mapping.scene_map import MapPiece


def _write_clip(folder: Path) -> None:
    """Write a short clip as pictures, poses, depth in millimetres and the calibration matrix."""
    for name in ("color", "pose", "depth"):
        (folder / name).mkdir(parents=True)
    for k, view in enumerate(RenderedSequence("street", 96, 80, num_frames=9).rendered()):
        cv2.imwrite(str(folder / f"color/{k:06d}.png"), view.frame.luma)
        pose = np.vstack([view.camera.cam_from_world, [0.0, 0.0, 0.0, 1.0]])
        np.savetxt(folder / f"pose/{k:06d}.txt", np.linalg.inv(pose))
        millimetres = np.where(np.isfinite(view.depth), 1000.0 * view.depth, 0.0)
        cv2.imwrite(str(folder / f"depth/{k:06d}.png"), np.clip(millimetres, 0, 65535).astype(np.uint16))
    np.savetxt(folder / "intrinsics.txt", view.camera.K)


def test_a_clip_is_measured_as_it_is_decoded(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Real processes code the pictures of a folder; the table says so, and all figures are kept."""
    _write_clip(tmp_path / "walk")
    words = [str(tmp_path / "walk"), "--qp", "30", "--step", "2", "--json", str(tmp_path / "figures.json")]
    assert main(words) == 0
    heading, row = capsys.readouterr().out.splitlines()
    assert heading.split()[:3] == ["clip", "frames", "mapper"]
    assert row.split()[:5] == ["walk", "5", "QP", "30", "native"]
    (figures,) = json.loads((tmp_path / "figures.json").read_text())
    assert {"located", "pieces", "wall_s"} <= figures.keys()


def test_every_second_frame_keeps_its_own_truth() -> None:
    frames = [Frame(np.full((4, 4), k, np.uint8)) for k in range(5)]
    poses = {k: np.full((3, 4), float(k)) for k in range(5)}
    found = every(Clip(frames, poses, {2: np.ones((4, 4), np.float32)}), 2)
    assert [frame.luma[0, 0] for frame in found.frames] == [0, 2, 4]
    assert {k: pose[0, 0] for k, pose in found.poses.items()} == {0: 0.0, 1: 2.0, 2: 4.0}
    assert found.depths.keys() == {1}


def test_a_view_is_rendered_without_its_own_picture() -> None:
    frames = [Frame(np.full((16, 16), 60 + k, np.uint8)) for k in range(17)]
    poses = {k: np.column_stack([np.eye(3), [0.001 * k, 0.0, 0.0]]) for k in range(17)}
    depths = {k: np.full((16, 16), 2.0, np.float32) for k in (0, 8, 16)}
    piece = MapPiece(np.eye(3), poses, np.empty((0, 3)), np.empty((0, 3), np.uint8), depths)
    quality = view_quality(piece, Clip(frames, {}, {}), frames)
    assert quality["views"] == 1
    assert quality["nearest_psnr_db"] == pytest.approx(20.0 * np.log10(255.0 / 8.0), abs=0.1)
    assert quality["view_psnr_db"] > quality["nearest_psnr_db"] + 6.0  # the mean of both sides


def test_depth_of_another_camera_is_seen_through_the_own_one() -> None:
    measured = np.full((20, 20), 3.0, np.float32)
    measured[10, 14] = 2.0
    clip = Clip([], {}, {0: measured}, np.array([[20.0, 0, 10], [0, 20, 10], [0, 0, 1]]))
    seen = true_depth(clip, 0, np.array([[10.0, 0, 10], [0, 10, 10], [0, 0, 1]]))
    assert seen[10, 12] == 2.0
    assert np.isinf(seen[0]).all()


def test_a_line_has_dashes_where_there_is_no_figure() -> None:
    """COLMAP by itself gives no depth."""
    words = line({"clip": "a", "frames": "5 original", "mapper": "m", "located": 5, "wall_s": 2.0}).split()
    assert words == ["a", "5", "original", "m", "5", *["-"] * 6, "2"]


def _piece(depth: np.ndarray) -> MapPiece:
    return MapPiece(np.eye(3), {0: np.eye(3, 4)}, np.empty((0, 3)), np.empty((0, 3), np.uint8), {0: depth})


def test_depth_is_compared_in_one_scale() -> None:
    """The unit of the map does not count; unknown depth is wrong, and pixels without truth are left out."""
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
