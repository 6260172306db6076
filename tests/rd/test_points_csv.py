"""Points as comma-separated values: import and export."""

import csv
import io
import json
import re
from pathlib import Path

import pytest

from dvc.rd import points_csv
from dvc.rd.__main__ import main
from dvc.rd.points_csv import FRAME_COLUMNS, POINT_COLUMNS, results_csv
from dvc.rd.rd_curves import experiments
from dvc.rd.rd_report import preface
from dvc.rd.rd_results import POINTS_FOLDER, parse_result, read_results
from tests.rd.made_up import result_data, write_colour_results, write_results

HEAD = "sequence,codec,rate_kbps,psnr_y_db,frames"
SIZE = "width,height,frames_per_s"


def write_points(folder: Path, *lines: str) -> str:
    path = folder / "theirs.csv"
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return str(path)


def test_points_join_measured_experiments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points of a sequence that was measured are a curve of its experiment, which compare and report show."""
    ours = write_results(tmp_path / "ours")
    lines = [
        "# from a paper",
        f"{HEAD},luma_only",
        "clip,Theirs,50,29,3,true",
        "clip,Theirs,100,32.5,3,true",
        "clip,Theirs,180,35.5,3,true",
    ]
    assert main(["import", write_points(tmp_path, *lines), "--out", str(ours)]) == 0
    assert capsys.readouterr().err == "dvc-rd: 3 points imported\n"
    (experiment,) = experiments(read_results(ours))
    curve = {curve.label: curve for curve in experiment.curves}["Theirs"]
    assert curve.is_anchor
    assert (curve.rates_kbps, curve.psnrs_y_db) == ([50.0, 100.0, 180.0], [29.0, 32.5, 35.5])
    assert [point.label for point in curve.points] == ["50 kbit/s", "100 kbit/s", "180 kbit/s"]
    assert main(["compare", str(ours), "--against", "Theirs"]) == 0
    assert "| clip | 2D-DVC, GOP 2 | Theirs | +" in capsys.readouterr().out
    assert main(["report", str(ours)]) == 0
    report = (ours / "report.md").read_text(encoding="utf-8")
    assert "### clip, Theirs" in report
    assert "4 points, measured 2026-01-31" in report
    assert "3 points were not measured here: rates and PSNRs are those of theirs.csv." in report
    assert "Theirs" in (ours / "report.html").read_text(encoding="utf-8")


def test_other_frames_are_another_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points on frames that nothing was measured on need the size, and the command says so."""
    ours = write_results(tmp_path / "ours")
    points = write_points(tmp_path, f"{HEAD},{SIZE}", "clip,Theirs,50,29,7,64,48,25")
    assert main(["import", points, "--out", str(ours)]) == 0
    assert f"nothing is measured in {ours} on these frames of clip\n" in capsys.readouterr().err
    assert len(experiments(read_results(ours))) == 2


def test_points_of_opendvc(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert main(["import", "opendvc", "--out", str(folder)]) == 0
    results = read_results(folder)
    assert {result.label for result in results} >= {"Q1, key QP 40", "Q8, key QP 25"}
    assert preface(results).startswith(
        "12 points were not measured here: rates and PSNRs are those of JM 18.5, "
    )
    capsys.readouterr()
    assert main(["compare", str(folder), "--against", "JM"]) == 0
    assert "| foreman_qcif15 | openDVC | JM 18.5 intra | -" in capsys.readouterr().out
    assert main(["report", str(folder)]) == 0


def test_what_was_exported_can_be_imported(tmp_path: Path) -> None:
    ours, table, theirs = write_results(tmp_path / "ours"), tmp_path / "points.csv", tmp_path / "theirs"
    assert main(["export", str(ours), "--csv", str(table)]) == 0
    assert main(["import", str(table), "--out", str(theirs)]) == 0
    (before,), (after,) = experiments(read_results(ours)), experiments(read_results(theirs))
    assert after.key == before.key
    curves = [{curve.label: curve.rates_kbps for curve in one.curves} for one in (before, after)]
    assert curves[0] == curves[1]


def test_imported_points_are_in_colour(tmp_path: Path) -> None:
    """Unless a column says luma only, rates are of all planes; PSNRs of chroma are taken over."""
    ours, table, theirs = (
        write_colour_results(tmp_path / "ours"),
        tmp_path / "points.csv",
        tmp_path / "theirs",
    )
    assert main(["export", str(ours), "--csv", str(table)]) == 0
    lines = table.read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("luma_only")
    cells = [line.replace(", GOP", " GOP").split(",") for line in lines]
    bare = [",".join(row[:column] + row[column + 1 :]) for row in cells]
    assert main(["import", write_points(tmp_path, *bare), "--out", str(theirs)]) == 0
    (before,), (after,) = experiments(read_results(ours)), experiments(read_results(theirs))
    assert before.key == after.key
    assert before.key[-1] is False
    found = [sorted(curve.psnrs_yuv_db for curve in one.curves) for one in (before, after)]
    assert found[0] == found[1]


def test_importing_again_replaces(tmp_path: Path) -> None:
    """A corrected file leaves none of the old points of its curves; other curves stay."""
    size = "3,64,48,25"
    for lines in (
        [f"clip,A,50,29,{size}", f"clip,A,90,31,{size}", f"clip,B,50,28,{size}"],
        [f"clip,A,55,29,{size}"],
    ):
        points = write_points(tmp_path, f"{HEAD},{SIZE}", *lines)
        assert main(["import", points, "--out", str(tmp_path)]) == 0
    (experiment,) = experiments(read_results(tmp_path))
    assert {curve.label: curve.rates_kbps for curve in experiment.curves} == {"A": [55.0], "B": [50.0]}


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "no column sequence, codec, rate_kbps, psnr_y_db, frames"),
        (["sequence,codec,rate_kbps", "clip,A,1"], "no column psnr_y_db"),
        ([HEAD], "no points"),
        ([HEAD, "clip,A,1,30"], "line 2: 4 cells under 5 columns"),
        ([HEAD, "# two", "clip,,1,30,3"], "line 3: Object missing required field `codec`"),
        ([HEAD, "clip,A,nan,30,3"], "line 2: Expected `float` > 0.0 - at `rate_kbps`"),
        ([HEAD, "clip,A,1,-3,3"], "line 2: Expected `float` > 0.0 - at `psnr_y_db`"),
        ([HEAD, "clip,A,1e300,30,3"], "line 2: Expected `float` <= 1000000000.0 - at `rate_kbps`"),
        ([HEAD, "clip,\x1b[31mA,1,30,3"], "line 2: sequence or codec has characters that cannot be shown"),
        (
            [HEAD, "clip,A,1,30,3"],
            "line 2: width, height, frames_per_s must be given, as nothing is measured here",
        ),
        (
            [f"{HEAD},{SIZE}", "clip,A,1,30,3,64,x,25"],
            "line 2: Expected `int | null`, got `str` - at `height`",
        ),
        ([f"{HEAD},luma_only", "clip,A,1,30,3,no"], "line 2: Expected `bool`, got `str` - at `luma_only`"),
        ([f"{HEAD},{SIZE}", *["clip,A,1,30,3,64,48,25"] * 2], "line 3: the same point a second time"),
        (
            [f"{HEAD},{SIZE}", "clip,A,1,30,3,64,48,1e-308"],
            "line 2: 3 frames, 1e-308 a second, last too long",
        ),
        ([HEAD, '"clip,A,1,30,3'], "line 2: unexpected end of data"),
    ],
)
def test_damaged_files_are_refused(
    lines: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", write_points(tmp_path, *lines), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"dvc-rd: theirs.csv: {message}")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_files_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe")
    monkeypatch.setattr(points_csv, "MAX_CHARACTERS", 1000)
    for name in ("missing.csv", "bytes.csv", "/dev/zero"):
        assert main(["import", str(tmp_path / name), "--out", str(tmp_path)]) == 2
    message = capsys.readouterr().err.splitlines()
    assert ["cannot be read" in line for line in message] == [True, True, False]
    assert message[2] == "dvc-rd: /dev/zero: more than 1000 characters"


def test_damaged_imported_results_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert main(["import", "opendvc", "--out", str(tmp_path)]) == 0
    path = min((tmp_path / POINTS_FOLDER).iterdir())
    data = json.loads(path.read_text(encoding="utf-8"))
    del data["options"]["options"]["curve"]
    path.write_text(json.dumps(data), encoding="utf-8")
    assert len(read_results(tmp_path)) == 11
    assert "options.options lacks the name of the curve or point; left out" in caplog.text


def test_points_are_lines(tmp_path: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(results_csv(read_results(write_results(tmp_path / "a"))))))
    text = (Path(__file__).parents[2] / "docs" / "rd.md").read_text(encoding="utf-8")
    points, frames = (
        re.findall(r"`([a-z_]+)`", re.sub(r"\([^)]*\)", "", line))
        for line in text.splitlines()
        if line.startswith(("| points | `sequence`", "| frames | `sequence`"))
    )
    assert list(rows[0]) == points == ["sequence", "curve", *POINT_COLUMNS]
    assert frames == results_csv([], per_frame=True).strip().split(",")
    assert [row["curve"] for row in rows] == ["2D-DVC, GOP 2"] * 3 + ["H.264 intra"] * 3
    first = rows[0]
    assert (first["rate_kbps"], first["psnr_y_db"], first["wz_q"]) == ("60.0", "29.0", "1")
    assert (first["parity_bits"], first["lossless_keys"], first["luma_only"]) == ("1600", "false", "true")
    assert rows[-1]["si_psnr_y_db"] == rows[-1]["wz_q"] == rows[0]["psnr_yuv_db"] == ""
    colours = results_csv(read_results(write_colour_results(tmp_path / "b")))
    first = next(csv.DictReader(io.StringIO(colours)))
    assert [first[name] for name in ("psnr_cb_db", "psnr_cr_db", "psnr_yuv_db")] == ["39.0", "39.0", "31.5"]


def test_frames_are_lines() -> None:
    frames = [
        {"index": 0, "type": "intra", "bits": 800, "psnr_y_db": 31.5},
        {
            "index": 1,
            "type": "wz",
            "bits": {"parity": 80, "crc": 10},
            "psnr_y_db": 30.5,
            "si_psnr_y_db": 28.25,
        },
    ]
    sequence = {**result_data(60.0, 30.0)["sequence"], "name": 'a, "b"\nc'}
    result = parse_result("p", result_data(60.0, 30.0, per_frame=frames, sequence=sequence))
    rows = list(csv.DictReader(io.StringIO(results_csv([result], per_frame=True), newline="")))
    assert rows[0]["sequence"] == 'a, "b"\nc'
    assert tuple(rows[0])[-len(FRAME_COLUMNS) :] == FRAME_COLUMNS
    assert [(row["point"], row["index"], row["type"], row["si_psnr_y_db"]) for row in rows] == [
        ("p", "0", "intra", ""),
        ("p", "1", "wz", "28.25"),
    ]
    bits = [(row["bits"], row["parity_bits"], row["crc_bits"], row["key_bits"]) for row in rows]
    assert bits == [("800", "", "", ""), ("90", "80", "10", "")]


def test_export_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = write_results(tmp_path / "a")
    assert main(["export", str(folder), "--csv", str(tmp_path / "points.csv")]) == 0
    assert len((tmp_path / "points.csv").read_text(encoding="utf-8").splitlines()) == 7
    assert main(["export", str(folder), "--frames", "--csv", "-"]) == 0
    assert len(capfd.readouterr().out.splitlines()) == 1 + 6 * 3
    assert main(["export", str(folder), "--csv", str(tmp_path / "nowhere" / "x.csv")]) == 2
    assert "does not exist" in capfd.readouterr().err
