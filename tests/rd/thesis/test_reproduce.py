"""The reproduction of the thesis: what it measures, and the document, from made-up points."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from dvc import cli
from dvc.errors import ConfigError, DvcError
from dvc.rd.__main__ import main
from dvc.rd.points import Point
from dvc.rd.processes import ProcessGroup
from dvc.rd.results import POINTS_FOLDER, read_results
from dvc.rd.sweep import SweepSummary
from dvc.rd.thesis import reproduce
from dvc.rd.thesis.chapter import Preset
from dvc.rd.thesis.chapter5_curves import METHODS
from dvc.rd.thesis.reproduce import (
    PRESETS,
    chapters,
    document_text,
    plan,
    planned_results,
    preset_sequences,
)
from tests.rd.made_up import result_data

TINY = Preset(5, (1, 8), ("intra", "x264-ippp-zero", "x264-ippp"), (30,), ("street",), ())
SHAPE = (32, 48)
SIDE_INFORMATION_DB = {"2d": 22.0, "3d": 23.0, "3d-td": 28.0, "3d-te": 29.0}
GAIN_DB = {"2d": 0.0, "3d": -1.0, "3d-td": 0.5, "3d-te": 1.0, "h264-intra": -2.0, "x264-ippp": 3.0}


def _frames(point: Point, level_db: float) -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = [{"index": 0, "type": "key", "psnr_y_db": 36.0, "bits": 900}]
    if point.wz_q is not None:
        wyner_ziv = {"type": "wz", "psnr_y_db": 33.0, "si_psnr_y_db": level_db, "bits": 90}
        frames += [{"index": index, **wyner_ziv} for index in (1, 2, 3)]
    return [*frames, {"index": 4, "type": "key", "psnr_y_db": 36.0, "bits": 900}]


def _made_up(point: Point) -> dict[str, Any]:
    """Return a result of a point as if it had been measured."""
    lossless = point.key_qp == "lossless"
    quality = point.wz_q or (51 - int(point.key_qp)) / 6
    data = result_data(100.0 * quality, 28.0 + quality + GAIN_DB.get(point.codec, 0.0), codec=point.codec)
    level_db = SIDE_INFORMATION_DB.get(point.codec, 0.0)
    data["options"] = point.to_dict()
    data["key"] = {"qp": 0 if lossless else 30, "lossless": lossless}
    data["sequence"]["name"] = Path(point.sequence).stem
    data["totals"] |= {"si_psnr_y_db": level_db, "key_psnr_y_db": 36.0, "frames": 5}
    data["per_frame"] = _frames(point, level_db)
    if point.wz_q is not None:
        data["pictures"] = {"index": 1, "original": "pictures/o.png", "predicted": "pictures/p.png"}
        data["pictures"] |= {"key_index": 0, "key": "pictures/o.png"}
    return data


def _measure_nothing(points: list[Point], folder: Path, *_: object, **__: object) -> SweepSummary:
    """Write made-up results instead of measuring."""
    import cv2

    for name in (POINTS_FOLDER, "pictures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(2)
    for name in "op":
        cv2.imwrite(str(folder / "pictures" / f"{name}.png"), rng.integers(0, 255, SHAPE).astype(np.uint8))
    for number, point in enumerate(points):
        cli.write_json(folder / POINTS_FOLDER / f"{number}.json", _made_up(point))
    return SweepSummary(num_measured=len(points))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Write made-up results of all points of a tiny preset."""
    _measure_nothing(plan(TINY, ["street"]), tmp_path / "thesis")
    return tmp_path / "thesis"


class Document(NamedTuple):
    """A document that was made once, and the folder of its pictures."""

    text: str
    folder: Path


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> Document:
    """Make the document of made-up results of all points of a tiny preset."""
    folder = tmp_path_factory.mktemp("thesis")
    _measure_nothing(plan(TINY, ["street"]), folder)
    return Document(document_text(read_results(folder), folder, "command"), folder)


def test_plan_has_every_curve_once() -> None:
    """The plan has the curves of figure 5.15 and the methods of table 5.1, and no point twice."""
    points = plan(TINY, ["street", "box"])
    assert len(points) == len(set(points))
    codecs = {point.codec for point in points}
    assert {"h264-intra", "x264-ippp-zero", "x264-ippp", "2d", "3d", "3d-td", "3d-te"} == codecs
    lossless = [point for point in points if point.key_qp == "lossless" and point.sequence == "box"]
    assert len(lossless) == len(METHODS)
    assert {point.gop for point in lossless} == {10}
    assert {point.frames for point in points} == {5}
    with pytest.raises(ConfigError, match="no sequence"):
        plan(TINY, [])


def test_presets_take_the_clips_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendered scenes are always there, real clips only where the folder of video files has them."""
    monkeypatch.setenv("DVC_DATA", str(tmp_path))
    for name in ("tree.mkv", "other.mkv"):
        (tmp_path / name).write_bytes(b"x")
    processes = ProcessGroup()
    assert preset_sequences(PRESETS["full"], processes) == ("street", "stairway", "statue", "tree")
    assert preset_sequences(PRESETS["quick"], processes) == ("street",)


def test_document_has_table_5_1_beside_the_thesis(document: Document) -> None:
    """Each method has its side information, beside the number of the thesis."""
    text = document.text
    assert "| 2D-DVC (block motion) | 22.0 (22.3) |" in text
    assert "| 3D-DVC-TE (mesh) | 29.0 (29.3) |" in text
    assert "| 3D-DVC-TE (depth) | 29.0 |" in text
    assert "| TE, key frames only | 2D-DVC | street | -" in text
    assert "| TE, key frames only | H.264 IPPP | street | +" in text
    assert "better at all common rates" in text


def test_document_names_files_and_headings_that_are_there(document: Document) -> None:
    """Every link of the document leads to a picture beside it, to a heading, or to the report."""
    text, folder = document
    headings = {
        re.sub(r"[^a-z0-9 -]", "", line.lstrip("# ").lower()).replace(" ", "-")
        for line in text.splitlines()
        if line.startswith("#")
    }
    targets = re.findall(r"\]\(([^)]*)\)", text)
    assert sum(target.endswith(".png") for target in targets) == 4
    for target in targets:
        if target.startswith("#"):
            assert target[1:] in headings
        elif target not in (reproduce.REPORT, reproduce.PAGE):
            assert (folder / target).read_bytes().startswith(b"\x89PNG")


def test_document_of_few_points(folder: Path) -> None:
    """What has not been measured is left out, or is a dash."""
    results = [result for result in read_results(folder) if result.data["codec"] == "2d"]
    text = document_text(results, folder, "command")
    assert "| 3D-DVC (mesh) | – (23.3) |" in text
    assert "| TD | 2D-DVC |" not in text


def test_document_without_pictures_of_points(folder: Path) -> None:
    """A picture of a point that is missing is left out."""
    (folder / "pictures" / "p.png").unlink()
    text = document_text(read_results(folder), folder, "command")
    assert not re.search(r"5\.1[24]\.png", text)
    assert "5.11.png" in text


def test_command_writes_all_documents(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The command measures the plan of the preset, and names the documents that it writes."""
    monkeypatch.setitem(PRESETS, "quick", TINY)
    monkeypatch.setattr("dvc.rd.sweep.run_points", _measure_nothing)
    out = tmp_path / "out"
    assert main(["reproduce", "thesis", "--sequences", "street", "--out", str(out)]) == 0
    captured = capfd.readouterr()
    assert next(Path(line).name for line in captured.out.splitlines()) == reproduce.DOCUMENT
    assert all(Path(line).is_file() for line in captured.out.splitlines())
    assert "dvc-rd reproduce thesis --preset quick --sequences street" in (out / "thesis.md").read_text()


def test_every_chapter_names_its_figures() -> None:
    """A chapter that is registered has figures, and places for them."""
    for chapter in chapters():
        assert chapter.figures
        assert all(figure.number and figure.place for figure in chapter.figures)


def test_documents_are_the_same_when_made_again(document: Document) -> None:
    """A document that is made again has the same pictures."""
    first, folder = document
    pictures = {path.name: path.read_bytes() for path in folder.glob("*.png")}
    assert document_text(read_results(folder), folder, "command") == first
    assert {path.name: path.read_bytes() for path in folder.glob("*.png")} == pictures


def test_presets_are_documented() -> None:
    """The document of results tells how many points and frames each preset has."""
    text = (Path(__file__).parents[3] / "docs" / "rd.md").read_text(encoding="utf-8")
    points = [len(plan(PRESETS[name], ["street"])) for name in ("quick", "full")]
    frames = [PRESETS[name].frames for name in ("quick", "full")]
    assert f"| points per sequence | {points[0]} | {points[1]} |" in text
    assert f"| frames (`--frames`; the thesis has 50) | {frames[0]} | {frames[1]}, which" in text


def test_results_outside_the_plan_are_left_out(folder: Path) -> None:
    """Points that somebody else has measured into the same folder, and JM's rows, do not count."""
    points = plan(TINY, ["street"])
    other = _made_up(Point("street", "2d", 3, "auto", 4))
    cli.write_json(folder / POINTS_FOLDER / "other.json", other)
    results = read_results(folder)
    assert len(planned_results(results, points)) == len(points) == len(results) - 1
    written = reproduce.write_reproduction(folder, "command", points, page=False)
    assert [path.name for path in written] == [reproduce.DOCUMENT, reproduce.REPORT]
    text = written[0].read_text(encoding="utf-8")
    assert f"Made by `command`: {len(points)} points" in text
    assert "GOP 4" not in written[1].read_text(encoding="utf-8")
    assert reproduce.PAGE not in text
    assert f"[the report]({reproduce.REPORT})" in text
    with pytest.raises(DvcError, match="none of the points"):
        reproduce.write_reproduction(folder, "command", plan(TINY, ["box"]))


def test_lossy_points_are_told_by_their_qp(folder: Path) -> None:
    """Figure 5.13 has a line for every QP, the coarsest first, and lossless key frames last."""
    results = read_results(folder)
    for result in results:
        if result.data["codec"] == "3d-te" and result.data["options"]["wz_q"] == 8:
            result.data["key"]["qp"] = 0 if result.data["key"]["lossless"] else 25
    lines = [line for line in document_text(results, folder, "c").splitlines() if "| street |" in line]
    assert [line.split("|")[2].strip() for line in lines if line.count("|") == 6] == ["30", "25", "lossless"]
