"""Rendered sequences as videos: the reader protocol, jobs, files, nothing half-written."""

import json
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from dvc.array_files import read_positions
from dvc.errors import ConfigError, DvcError, VideoError
from dvc.picture_files import read_pfm, read_picture, write_pfm
from dvc.video import open_video
from sequences.__main__ import main
from sequences.rendered_scenes import RenderedFrame, render_frame, render_picture, scene
from sequences.rendered_sequence import RenderedSequence, render
from sequences.scene_cameras import back_project, project
from sequences.scene_layouts import POSITIONS, STEP_DOWN_M, STEP_RIGHT_M
from tests.clips import same_frame


def short(**options: int) -> RenderedSequence:
    return RenderedSequence("stairway", 32, 25, **{"num_frames": 5, **options})


def test_sequence_keeps_the_reader_protocol() -> None:
    sequence = short()
    assert sequence.info.size == (32, 25)
    assert (sequence.info.frame_rate, sequence.info.num_frames) == (Fraction(30), 5)
    with sequence as reader:
        assert next(iter(reader)).width == 32
        assert len(list(reader)) == 4
        assert list(reader) == []
    closed = short()
    closed.close()
    closed.close()
    assert list(closed) == []


@pytest.mark.parametrize("jobs", [2, 3, 8])
def test_jobs_do_not_change_the_frames(jobs: int) -> None:
    for one, many in zip(short(), short(jobs=jobs), strict=True):
        assert same_frame(one, many)
    late = next(iter(short(start=120, num_frames=1, jobs=jobs)))  # beyond the usual length
    assert same_frame(late, render_frame(scene("stairway"), 120, 32, 25).frame)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("beach",), {}, "beach"),
        (("street",), {"num_frames": 0}, "0 frames"),
        (("street",), {"start": -1}, "start -1"),
        (("street",), {"jobs": 0}, "0 jobs"),
        (("street",), {"noise_sigma": float("nan")}, "noise"),
        (("street", 0, 10), {}, "0x10"),
    ],
)
def test_wrong_arguments_are_refused_at_once(
    arguments: tuple[Any, ...], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(DvcError, match=message):
        RenderedSequence(*arguments, **options)


def test_files_hold_what_was_rendered(tmp_path: Path) -> None:
    done: list[int] = []
    video, cameras, depth = tmp_path / "s.mkv", tmp_path / "s.json", tmp_path / "depth"
    render(short(start=3), video, cameras=cameras, depth=depth, progress=done.append)
    assert done == [1] * 5
    document = json.loads(cameras.read_text())
    assert (document["scene"], document["frame_rate"]) == ("stairway", "30")
    with open_video(video) as reader:
        assert reader.info.frame_rate == 30
        for frame, view in zip(reader, document["frames"], strict=True):
            truth = render_frame(scene("stairway"), view["index"], 32, 25)
            assert same_frame(frame, truth.frame)
            np.testing.assert_array_equal(view["cam_from_world"], truth.camera.cam_from_world)
            np.testing.assert_array_equal(view["K"], truth.camera.K)
            stored = read_pfm(depth / f"{view['index']:04d}.pfm")
            np.testing.assert_array_equal(stored, truth.depth)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["depth", "s.json", "s.mkv"]


class _Failing(RenderedSequence):
    def rendered(self) -> Iterator[RenderedFrame]:
        yield render_frame(scene("stairway"), 0, *self.info.size)
        raise VideoError("no more")


def test_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    failing = _Failing("stairway", 32, 25)
    with pytest.raises(VideoError, match="no more"):
        render(failing, tmp_path / "s.mkv", cameras=tmp_path / "s.json", depth=tmp_path / "depth")
    with pytest.raises(ConfigError, match="both"):
        render(short(), tmp_path / "s.mkv", cameras=tmp_path / "s.mkv")
    assert list(tmp_path.iterdir()) == []


def test_centres_form_a_lattice_of_cells_that_are_not_square() -> None:
    cameras = [scene("toy").camera(index) for index in range(4)]
    centres = np.stack([camera.centre for camera in cameras])
    steps = (centres - centres[0]).round(12)
    np.testing.assert_allclose(steps[1], [STEP_RIGHT_M, 0, 0], atol=1e-12)
    np.testing.assert_allclose(steps[2], [0, 0, -STEP_DOWN_M], atol=1e-12)
    np.testing.assert_allclose(steps[3], steps[1] + steps[2], atol=1e-12)
    axes = np.stack([camera.cam_from_world[2, :3] for camera in cameras])
    assert (axes @ axes.T)[~np.eye(4, dtype=bool)].max() < np.cos(np.radians(1.0))


def test_depth_and_cameras_explain_the_pictures() -> None:
    first, second = (render_picture(scene("toy"), index, 320, 240) for index in (0, 3))
    assert np.isfinite(first[1]).all()
    y, x = np.mgrid[4:240:8, 4:320:8]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    points = back_project(first[2], pixels, first[1][y, x].ravel().astype(np.float64))
    seen, depth = project(second[2], points)
    u, v = np.rint(seen).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < 320) & (v < 240)
    u, v = u[inside], v[inside]
    visible = np.abs(second[1][v, u] / depth[inside] - 1) < 0.01
    assert 0.6 < visible.mean() < 0.99
    colours = first[0][y, x].reshape(-1, 3)[inside].astype(float)
    assert np.median(np.abs(colours - second[0][v, u])[visible]) < 12


def test_command_writes_pictures_depth_and_cameras(tmp_path: Path) -> None:
    folder = tmp_path / "toy"
    assert main(["render", "toy", "--out", str(folder), "--size", "32x24"]) == 0
    cameras = json.loads((folder / "cameras.json").read_text())
    assert [camera["file"] for camera in cameras] == [f"toy-{m}-{n}.png" for m, n in POSITIONS]
    for camera in cameras:
        assert np.linalg.det(camera["R"]) == pytest.approx(1.0)
        assert read_picture(folder / camera["file"]).shape == (24, 32, 3)
        assert read_pfm(folder / f"depth-{Path(camera['file']).stem}.pfm").shape == (24, 32)
    assert list(read_positions(folder / "views.csv").values()) == [tuple(map(float, p)) for p in POSITIONS]


@pytest.mark.parametrize("option", [("--frames", "3"), ("--noise", "1"), ("--depth", "d")])
def test_options_of_videos_are_refused(
    tmp_path: Path, option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["render", "toy", "--out", str(tmp_path / "toy"), *option]) == 2
    assert f"{option[0]} applies to videos" in capsys.readouterr().err
    assert not (tmp_path / "toy").exists()


@given(arrays(np.float32, array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_pfm_round_trip(tmp_path_factory: pytest.TempPathFactory, plane: np.ndarray) -> None:
    path = tmp_path_factory.getbasetemp() / "plane.pfm"
    write_pfm(path, plane)
    np.testing.assert_array_equal(read_pfm(path), plane)
    path.write_bytes(b"Pf\n2 1\n1.0\n" + np.array([1.5, -2.0], dtype=">f4").tobytes())
    np.testing.assert_array_equal(read_pfm(path), [[1.5, -2.0]])


@given(st.binary(max_size=60) | st.binary(max_size=40).map(lambda b: b"Pf\n2 2\n-1.0\n" + b))
def test_damaged_pfm_raises_video_error_or_reads(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.pfm"
    path.write_bytes(content)
    with suppress(VideoError):
        assert read_pfm(path).ndim == 2
