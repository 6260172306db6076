"""Results as comma-separated values."""

import csv
import io
import re
from pathlib import Path

import pytest

from dvc.rd.__main__ import main
from dvc.rd.export import FRAME_COLUMNS, POINT_COLUMNS, results_csv
from dvc.rd.point_result import PointResult
from dvc.rd.results import read_results
from tests.rd.made_up import result_data, write_colour_results, write_results


def test_points_are_lines(tmp_path: Path) -> None:
    """Every point is a line, by curve and rate, with the columns in their order."""
    rows = list(csv.DictReader(io.StringIO(results_csv(read_results(write_results(tmp_path / "a"))))))
    assert list(rows[0]) == ["sequence", "curve", *POINT_COLUMNS]
    assert [row["curve"] for row in rows] == ["2D-DVC, GOP 2"] * 3 + ["H.264 intra"] * 3
    first = rows[0]
    assert (first["rate_kbps"], first["psnr_y_db"], first["wz_q"]) == ("60.0", "29.0", "1")
    assert (first["parity_bits"], first["lossless_keys"], first["luma_only"]) == ("1600", "false", "true")
    assert rows[-1]["si_psnr_y_db"] == rows[-1]["wz_q"] == ""


def test_points_in_colour_have_psnrs_of_chroma(tmp_path: Path) -> None:
    """The PSNRs of both planes and of all; empty without chroma."""
    names = ("psnr_cb_db", "psnr_cr_db", "psnr_yuv_db")
    text = results_csv(read_results(write_colour_results(tmp_path / "a")))
    first = next(csv.DictReader(io.StringIO(text)))
    assert [float(first[name]) for name in names] == [39.0, 39.0, 31.5]
    text = results_csv(read_results(write_results(tmp_path / "b")))
    assert {next(csv.DictReader(io.StringIO(text)))[name] for name in names} == {""}


def test_frames_are_lines() -> None:
    """Every frame is a line that names its point; cells without a value are empty."""
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
    text = results_csv([PointResult("p", result_data(60.0, 30.0, per_frame=frames))], per_frame=True)
    rows = list(csv.DictReader(io.StringIO(text)))
    assert tuple(rows[0])[-len(FRAME_COLUMNS) :] == FRAME_COLUMNS
    assert [(row["point"], row["index"], row["type"], row["si_psnr_y_db"]) for row in rows] == [
        ("p", "0", "intra", ""),
        ("p", "1", "wz", "28.25"),
    ]
    bits = [(row["bits"], row["parity_bits"], row["crc_bits"], row["key_bits"]) for row in rows]
    assert bits == [("800", "", "", ""), ("90", "80", "10", "")]


def test_names_with_commas_and_quotes_survive() -> None:
    """A name that has what separates cells is read back as it was."""
    sequence = {**result_data(60.0, 30.0)["sequence"], "name": 'a, "b"\nc'}
    text = results_csv([PointResult("p", result_data(60.0, 30.0, sequence=sequence))])
    (row,) = csv.DictReader(io.StringIO(text, newline=""))
    assert row["sequence"] == 'a, "b"\nc'


def test_export_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The command writes a file in one piece, or standard output."""
    folder = write_results(tmp_path / "a")
    assert main(["export", str(folder), "--csv", str(tmp_path / "points.csv")]) == 0
    assert len((tmp_path / "points.csv").read_text(encoding="utf-8").splitlines()) == 7
    assert main(["export", str(folder), "--frames", "--csv", "-"]) == 0
    assert len(capfd.readouterr().out.splitlines()) == 1 + 6 * 3
    assert main(["export", str(folder), "--csv", str(tmp_path / "nowhere" / "x.csv")]) == 2
    assert "does not exist" in capfd.readouterr().err


def test_columns_are_documented() -> None:
    """The document of results names every column, in the order of the file."""
    text = (Path(__file__).parents[2] / "docs" / "rd.md").read_text(encoding="utf-8")
    points, frames = (
        re.findall(r"`([a-z_]+)`", re.sub(r"\([^)]*\)", "", line))
        for line in text.splitlines()
        if line.startswith(("| points | `sequence`", "| frames | `sequence`"))
    )
    assert points == ["sequence", "curve", *POINT_COLUMNS]
    assert tuple(frames)[-len(FRAME_COLUMNS) :] == FRAME_COLUMNS
    assert frames == results_csv([], per_frame=True).strip().split(",")
