"""Chapter 5: points that are measured, and values of made-up points."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.thesis import chapter5
from benchmarks.thesis.chapter5 import (
    CHAPTER,
    CODECS,
    COMPARISONS,
    FULL,
    LOSSLESS_GOP,
    QUICK,
    ROWS,
    SCENES,
    curve_points,
    prediction_point,
)
from benchmarks.thesis.harness import Method, Task
from dvc import cli
from dvc.rd.rd_results import POINTS_FOLDER
from dvc.rd.run_points import SweepSummary
from dvc.rd.specification import Point
from tests.rd.made_up import result_data

SHAPE = (32, 48)
SIDE_INFORMATION_DB = {"2d": 22.0, "3d": 23.0, "3d-td": 28.0, "3d-te": 29.0}
GAIN_DB = {"2d": 0.0, "3d": -1.0, "3d-td": 0.5, "3d-te": 1.0, "h264-intra": -2.0, "x264-ippp": 3.0}


def _frames(point: Point, level_db: float) -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = [{"index": 0, "type": "key", "psnr_y_db": 36.0, "bits": 900}]
    if point.has_wyner_ziv:
        wyner_ziv = {"type": "wz", "psnr_y_db": 33.0, "si_psnr_y_db": level_db, "bits": 90}
        frames += [{"index": index, **wyner_ziv} for index in (1, 2, 3)]
    return [*frames, {"index": 4, "type": "key", "psnr_y_db": 36.0, "bits": 900}]


def _made_up(point: Point) -> dict[str, Any]:
    """Return a result of a point as if it had been measured."""
    lossless = point.key_qp == "lossless"
    qp = point.qp if point.qp is not None else 0 if not point.key_qp.isdecimal() else int(point.key_qp)
    quality = point.wz_q or (51 - qp) / 6
    data = result_data(100.0 * quality, 28.0 + quality + GAIN_DB.get(point.codec, 0.0), codec=point.codec)
    level_db = SIDE_INFORMATION_DB.get(point.codec, 0.0)
    data["options"] = point.to_dict()
    data["key"] = {"qp": 0 if lossless else 26 + (point.wz_q or 0), "lossless": lossless}
    data["sequence"]["name"] = Path(point.sequence).stem
    data["totals"] |= {"si_psnr_y_db": level_db, "key_psnr_y_db": 36.0, "frames": 5}
    data["per_frame"] = _frames(point, level_db)
    if point.has_wyner_ziv:
        data["pictures"] = {"index": 1, "original": "pictures/o.png", "predicted": "pictures/p.png"}
        data["pictures"] |= {"key_index": 0, "key": "pictures/o.png"}
    return data


def _measure_nothing(points: list[Point], folder: Path, *_: object, **__: object) -> SweepSummary:
    """Write made-up results instead of measuring."""
    for name in (POINTS_FOLDER, "pictures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(2)
    for name in "op":
        cv2.imwrite(str(folder / "pictures" / f"{name}.png"), rng.integers(0, 255, SHAPE).astype(np.uint8))
    before = len(list((folder / POINTS_FOLDER).iterdir()))
    digests = {}
    for number, point in enumerate(points, before):
        data = _made_up(point)
        cli.write_json(folder / POINTS_FOLDER / f"{number}.json", data)
        digests[point.sequence] = data["sequence"]["digest"]
    return SweepSummary(num_measured=len(points), digests=digests)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure nothing."""
    monkeypatch.setattr(chapter5, "run_points", _measure_nothing)


def test_points_as_written_are_those_of_the_text() -> None:
    """Turbo codes, DISCOVER matrices, meshes, GOPs of 2 and 10, only key frames as references."""
    curves = curve_points("street", QUICK, QUICK.frames, Method.THESIS)
    for name, codec in CODECS.items():
        for point, matrix in zip(curves[name], QUICK.wz_q, strict=True):
            options = dict(point.options)
            assert (point.codec, point.wz_q, point.qp, point.key_qp) == (codec, matrix, None, "auto")
            assert (options["coder"], options["noise-model"]) == ("turbo", "coefficient")
            assert point.side_information == (None if codec == "2d" else "mesh")
            assert dict(point.decoder) == ({} if codec == "2d" else {"sfm": "thesis"})
            assert options.get("references", "keys") == "keys"
    assert curves["2D-DVC"][0].gop == 2
    assert curves["3D-DVC"][0].gop == curves["3D-DVC-TD"][0].gop == LOSSLESS_GOP == 10
    anchors = {name: points for name, points in curves.items() if name not in CODECS}
    assert all(points and not point.has_wyner_ziv for points in anchors.values() for point in points)
    assert all(point.luma_only for points in curves.values() for point in points)
    assert {points[0].codec for points in anchors.values()} == {"h264-intra", "x264-ippp"}


def test_ours_have_their_own_settings() -> None:
    """Qualities instead of matrices, and defaults."""
    curves = curve_points("street", FULL, 5, Method.DEFAULT)
    for name in CODECS:
        assert [point.qp for point in curves[name]] == list(FULL.qp)
        assert all(point.options == () and point.side_information is None for point in curves[name])
        assert {(point.frames, point.luma_only) for point in curves[name]} == {(5, True)}


def test_table_5_1_is_measured_with_lossless_key_frames() -> None:
    """As written by blocks and meshes, ours by depth; a row for each."""
    written = [prediction_point(row, "street", 9, Method.THESIS) for row in ROWS[Method.THESIS]]
    assert [point.side_information for point in written] == [None, *("blocks", "mesh") * 3]
    assert all(point.key_qp == "lossless" and point.gop == LOSSLESS_GOP for point in written)
    ours = [prediction_point(row, "street", 9, Method.DEFAULT) for row in ROWS[Method.DEFAULT]]
    assert [point.codec for point in ours] == list(CODECS.values())
    assert {point.side_information for point in ours} == {None}
    assert all(point.luma_only for point in (*written, *ours))


@pytest.mark.parametrize("method", Method)
def test_side_information_stands_beside_the_thesis(tmp_path: Path, measured: None, method: Method) -> None:
    """Values have the names under which the thesis prints them; figures are drawn."""
    made = _step("side-information-street").make(Task(tmp_path), method)
    values = {(value.source, value.label): value.text for value in made.values}
    assert values["Table 5.1", "street: 3D-DVC-TE (mesh) [dB]"] == "29.0"
    assert set(values) <= set(CHAPTER.printed)
    assert CHAPTER.printed["Table 5.1", "street: 3D-DVC-TE (mesh) [dB]"] == "29.3"
    assert set(made.plots) == {("5.11", "street")}
    assert set(made.pictures) == {("5.12", "street")}


@pytest.mark.parametrize("method", Method)
def test_curves_are_compared(tmp_path: Path, measured: None, method: Method) -> None:
    """Every comparison of the thesis is made."""
    made = _step("curves-street").make(Task(tmp_path), method)
    values = {(value.source, value.label): value.text for value in made.values}
    outcomes = {label: text for (source, label), text in values.items() if source == "Figure 5.15"}
    assert len(outcomes) == len(COMPARISONS)
    assert outcomes["street: 3D-DVC-TE against 2D-DVC"].startswith("better at all common rates; -")
    assert outcomes["street: 3D-DVC-TE against H.264 IPPP"].startswith("worse at all common rates; +")
    assert values["Figure 5.14", "street: frame predicted from it [dB]"] == "29.0"
    assert values["Figure 5.14", "street: key frame, QP near 26 [dB]"] == "36.0"
    assert set(values) <= set(CHAPTER.printed)
    assert set(made.plots) == {("5.13", "street"), ("5.15", "street")}
    assert set(made.pictures) == {("5.14", "street")}


def test_failures_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Failed points are named, and the remaining ones are shown."""

    def _some(points: list[Point], folder: Path, **options: Any) -> SweepSummary:
        measured = _measure_nothing(points[1:], folder)
        return replace(measured, failures=[("first", "no decoder")])

    monkeypatch.setattr(chapter5, "run_points", lambda points, folder, *_, **__: _some(points, folder))
    made = _step("side-information-street").make(Task(tmp_path), Method.THESIS)
    assert made.failures == ["first: no decoder"]
    assert len(made.values) == len(ROWS[Method.THESIS]) - 1


def test_results_of_another_clip_of_the_name_are_not_taken(tmp_path: Path, measured: None) -> None:
    """Results of an earlier clip stay in the folder, but are not shown."""
    step = _step("side-information-street")
    step.make(Task(tmp_path), Method.THESIS)
    files = sorted((tmp_path / POINTS_FOLDER).iterdir())
    for path in files:
        data = json.loads(path.read_text())
        data["sequence"]["digest"] = "0" * 32
        data["totals"]["si_psnr_y_db"] = 99.0
        cli.write_json(tmp_path / POINTS_FOLDER / f"z{path.name}", data)
    made = step.make(Task(tmp_path), Method.THESIS)
    assert len(made.values) == len(ROWS[Method.THESIS])
    assert "99.0" not in {value.text for value in made.values}


def test_presets_take_the_clips_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendered scenes always exist, real clips only if the folder of video files has them."""
    monkeypatch.setenv("DVC_DATA", str(tmp_path))
    for name in ("tree.mkv", "other.mkv"):
        (tmp_path / name).write_bytes(b"x")
    full = {step.name for step in CHAPTER.steps(Task(tmp_path, full=True))}
    assert {f"curves-{name}" for name in (*SCENES, "tree")} <= full
    assert "curves-other" not in full
    quick = [step.name for step in CHAPTER.steps(Task(tmp_path))]
    assert quick == ["correspondences-street", "side-information-street", "curves-street"]


def _step(name: str) -> Any:
    return next(step for step in CHAPTER.steps(Task(Path(), chosen=("street",))) if step.name == name)
