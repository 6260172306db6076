"""Options of the command that need no more than a small stream."""

from pathlib import Path
from typing import Any

import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from sfm.mapping.scene_map import SceneMap
from sfm.output import scene_folder
from tests.clips import moving_texture, write_clip


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stream")
    clip = write_clip(folder / "clip.y4m", moving_texture(3, 24, 32))
    assert encoder.main([str(clip), str(folder / "clip.dvc"), "--qp", "34", "--gop", "2", "--quiet"]) == 0
    return folder / "clip.dvc"


def test_a_map_is_made_of_what_was_decoded(
    stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, mapped, folder = tmp_path / "plain.y4m", tmp_path / "mapped.y4m", tmp_path / "map"
    asked: list[Any] = []

    def _map_to_folder(path: str, *arguments: Any) -> SceneMap:
        asked.append((Path(path).read_bytes(), *arguments[:2]))
        arguments[2]("matching points")
        return SceneMap(32, 24, 3, ())

    monkeypatch.setattr(scene_folder, "map_to_folder", _map_to_folder)
    assert decoder.main([str(stream), str(plain), "--quiet"]) == 0
    assert not asked
    assert decoder.main([str(stream), str(mapped), "--scene", str(folder), "--mapper", "colmap"]) == 0
    assert asked == [(plain.read_bytes(), str(folder), "colmap")]
    lines = capsys.readouterr().err.splitlines()
    assert lines[-2:] == [
        "dvc-decode: matching points",
        "dvc-decode: map: no frame of 3 located: few points, or no parallax",
    ]


@pytest.mark.parametrize(
    ("output", "options", "message"),
    [
        ("out.mp4", ["--scene", "map"], "it must be .y4m or .mkv, got out.mp4"),
        ("out.mkv", ["--scene", str(Path(__file__).parent)], "it exists and is not an empty folder"),
        ("out.mkv", ["--mapper", "native"], "--mapper requires --scene"),
    ],
)
def test_maps_that_cannot_be_made_are_refused_at_once(
    stream: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    output: str,
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "something").touch()
    assert decoder.main([str(stream), output, *options]) == 2
    captured = capsys.readouterr().err
    assert message in captured
    assert captured.count("\n") == 1
    assert not Path(output).exists()
