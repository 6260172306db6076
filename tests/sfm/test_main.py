"""The command `dvc-sfm`: files it writes, and wrong input."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dvc.geometry.cameras import PixelFrame
from dvc.video import create_video
from sfm.__main__ import main
from sfm.mapping.scene_map import SceneMap
from sfm.output.map_files import ZOOM, draw_correspondences, side_by_side
from sfm.scene_model import Correspondences
from tests.scenes_3d import render
from tests.sfm.plane_map import frames_of, map_of, piece_of

FRAME = PixelFrame(176, 144)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    import cv2

    folder = tmp_path_factory.mktemp("pictures")
    for name, position in (("a", 0.0), ("b", 1.0)):
        cv2.imwrite(str(folder / f"{name}.png"), render(position, FRAME)[0])
    return str(folder / "a.png"), str(folder / "b.png")


@pytest.mark.parametrize("backend", ["native", "colmap"])
def test_a_model_is_written(
    pictures: tuple[str, str], backend: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Model, points, COLMAP's files and the picture; the summary counts correspondences."""
    assert main([*pictures, "--out", str(tmp_path / "m"), "--sfm", backend]) == 0
    names = (
        "cameras.txt correspondences.png frames.txt images.txt model.json points.ply points3D.txt rigs.txt"
    )
    assert sorted(path.name for path in (tmp_path / "m").iterdir()) == names.split()
    values = json.loads((tmp_path / "m" / "model.json").read_text())
    assert values["success"]
    assert "propagation" in capsys.readouterr().out


def test_no_model_is_no_error(
    pictures: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([pictures[0], pictures[0], "--out", str(tmp_path / "m")]) == 0
    values = json.loads((tmp_path / "m" / "model.json").read_text())
    assert not values["success"]
    assert values["reason"]
    assert "motion: none" in capsys.readouterr().out


@pytest.fixture
def mapped(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Put a map in the place of the mapper; return what it is called with."""
    calls: list[tuple[str, str]] = []

    def map_video(
        path: str, *, mapper: str = "native", report: Callable[[str], None] | None = None
    ) -> SceneMap:
        calls.append((path, mapper))
        if report is not None:
            report("half of it")
        return map_of(piece_of(range(3), 48, 32), size=(48, 32), num_frames=4)

    module = ModuleType("sfm.mapping.map_sequence")
    module.map_video = map_video  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "sfm.mapping.map_sequence", module)
    return calls


@pytest.fixture
def video(tmp_path: Path) -> str:
    with create_video(tmp_path / "clip.mkv", (48, 32), 25) as writer:
        for number in range(4):
            writer.write(frames_of(48, 32)(number))
    return str(tmp_path / "clip.mkv")


def test_a_video_becomes_a_folder(
    mapped: list[tuple[str, str]], video: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files and page of the map, one line of summary, progress on stderr; quiet says nothing."""
    assert main([video, "--out", str(tmp_path / "map")]) == 0
    values = json.loads((tmp_path / "map" / "scene.json").read_text())
    assert values["frames_per_second"] == 25.0
    assert "<h1>clip.mkv</h1>" in (tmp_path / "map" / "index.html").read_text(encoding="utf-8")
    told = capsys.readouterr()
    assert told.out == "map: 1 piece, 3 of 4 frames located\n"
    assert told.err == "dvc-sfm: half of it\n"
    assert main([video, "--out", str(tmp_path / "other"), "--mapper", "colmap", "--quiet"]) == 0
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", "")
    assert mapped == [(video, "native"), (video, "colmap")]


def test_bad_input_ends_in_one_line(
    mapped: list[tuple[str, str]],
    video: str,
    pictures: tuple[str, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Status 2, one line that names the option or the input, and nothing is mapped or written."""
    for arguments, told in (
        ([video, "--frames", "0", "1"], "--frames"),
        ([video, "--sfm", "colmap"], "--sfm"),
        ([video, "--seed", "0"], "--seed"),
        ([*pictures, "--mapper", "native"], "--mapper"),
        ([*pictures, "--frames", "0", "9"], "frame 9"),
        ([str(tmp_path / "no.mkv")], "no.mkv"),
        (["no.png", pictures[1]], "no.png"),
    ):
        assert main([*arguments, "--out", str(tmp_path / "m")]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert told in line
        assert not (tmp_path / "m").exists()
    for inputs in ([video], pictures, ["no.png", "no.png"]):  # the folder is refused before any work
        assert main([*inputs, "--out", str(tmp_path)]) == 2
        assert "not an empty folder" in capsys.readouterr().err
    assert mapped == []


def test_pictures_show_points_and_lines() -> None:
    luma = np.full((40, 60), 128, np.uint8)
    first = np.array([[10.0, 10.0], [30.0, 20.0], [1e12, -5.0]])
    matches = Correspondences(first, first + np.array([8.0, 0.0]), np.zeros(3))
    sideways = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    picture = draw_correspondences(luma, matches, sideways, "title")
    assert picture.shape == (36 + 40 * ZOOM, 60 * ZOOM, 3)
    blue, green, red = (picture[36:, :, channel].astype(int) for channel in range(3))
    assert ((red > 180) & (green < 120) & (blue < 120)).any()
    assert ((red > 180) & (blue > 180) & (green < 120)).any()
    assert ((green > 160) & (red < 140) & (blue < 140)).any()
    joined = side_by_side([picture, picture])
    assert joined.shape == (picture.shape[0], 2 * picture.shape[1] + 12, 3)
