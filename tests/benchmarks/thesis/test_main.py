"""Command `python -m benchmarks.thesis`: chapters, methods, files of the user, and errors."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.thesis.__main__ import main
from dvc.picture_files import write_pfm
from tests.dibr.scenes import texture, two_discs


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--chapter", "6"], "expected a chapter from 2 to 5"),
        (["--chapter", "4..3"], "expected a chapter from 2 to 5"),
        (["--chapter", "2", "--data", "."], "tsukuba: --data must name a folder"),
        (["--chapter", "2", "nothing", "--data", "sets"], "nothing: expected one of tsukuba"),
        (["--chapter", "3", "teddy"], "--data must name a folder"),
        (["--chapter", "3", "nothing"], "expected one of"),
        (["--chapter", "2", "teddy"], "--data must name a folder"),
        (["--chapter", "3", "none.png", "flat.png"], "none.png: no such file"),
        (["--chapter", "5", "nothing"], "neither a file nor a sequence"),
        (["--chapter", "3", "flat.png", "flat.png"], "need --disparities MIN:MAX"),
        (["--chapter", "4", "teddy", "--data", "."], "--data must name a folder"),
        (["--chapter", "4", "nothing"], "expected one of"),
        (["--chapter", "4", "flat.png"], "the map is constant"),
        (["--chapter", "4", "flat.png", "flat.png", "flat.png"], "takes a map and its picture, got 3 files"),
        (["--as", "mine"], "invalid choice"),
        (["--chapter", "3", "flat.png", "flat.png", "--disparities", "foo"], "expected MIN:MAX"),
        (["--chapter", "4", "small.pfm"], "small: the map is too small for a file of 0.2 bits per pixel"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    """Each ends with status 2 and one line."""
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("flat.png", np.full((32, 32), 9, np.uint8))
    write_pfm(Path("small.pfm"), two_discs(16, 16).astype(np.float32))
    try:
        status = main([*arguments, "--out", "out", "--quiet"])
    except SystemExit as end:
        status = int(str(end.code))
    captured = capsys.readouterr()
    assert status == 2
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert not list(tmp_path.glob("out/*/chapter*.md"))


def test_an_own_map_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The folder of the chapter has files of one method; the command prints the documents."""
    write_pfm(tmp_path / "discs.pfm", two_discs(64, 80).astype(np.float32))
    cv2.imwrite(str(tmp_path / "picture.png"), texture(64, 80))
    words = [str(tmp_path / "discs.pfm"), str(tmp_path / "picture.png"), "--out", str(tmp_path)]
    assert main(["--chapter", "4", "--as", "ours", *words]) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert written == [tmp_path / "chapter4" / name for name in ("chapter4.md", "index.html")]
    assert "|  | printed in the thesis | ours |" in written[0].read_text()
    names = {path.name for path in written[0].parent.glob("*.png")}
    assert {"figure-4.7-discs-ours.png", "figure-4.8b-discs-ours.png"} <= names
    assert not any("thesis" in name for name in names)
