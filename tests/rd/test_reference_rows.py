"""Rows of the reference software."""

from pathlib import Path

import pytest

from dvc.errors import DvcError
from dvc.rd.__main__ import main
from dvc.rd.curves import experiments
from dvc.rd.point_result import PointResult
from dvc.rd.reference_rows import ROWS_VARIABLE, read_reference_rows, reference_results
from dvc.rd.report import report_text
from dvc.rd.tables import preface
from tests.rd.made_up import result_data, write_colour_results

HEAD = "# a comment\nclip,codec,entropy,chroma,qp,frames,bits_total,kbps30,psnr_y\n"
ROWS = """clip,jm95-intra,cabac,none,28,3,24000,240.0,33.5
clip,jm95-intra,cabac,none,32,3,12000,120.0,30.5
clip,jm95-intra,cavlc,none,32,3,13000,130.0,30.5
clip,jm95-ippp-zero,cabac,none,32,3,6000,60.0,30.0
clip,jm95-ippp-zero,cabac,colour,32,3,7000,70.0,30.0
clip,x264-intra,cabac,none,32,3,7000,70.0,30.0
other,jm95-intra,cabac,none,32,3,7000,70.0,30.0
"""


@pytest.fixture
def rows(tmp_path: Path) -> Path:
    """Write a file of rows."""
    path = tmp_path / "rows.csv"
    path.write_text(HEAD + ROWS, encoding="utf-8")
    return path


def test_luma_rows_with_cabac_are_read(rows: Path) -> None:
    """Other entropy coders, colour and other codecs are left out."""
    assert [(row.clip, row.codec, row.qp) for row in read_reference_rows(rows)] == [
        ("clip", "jm95-intra", 28),
        ("clip", "jm95-intra", 32),
        ("clip", "jm95-ippp-zero", 32),
        ("other", "jm95-intra", 32),
    ]


def test_rows_stand_beside_what_was_measured(rows: Path) -> None:
    """Rows of the same clip and frames become anchors of that experiment, at its own frame rate."""
    own = [PointResult("a", result_data(60.0, 30.0))]
    (experiment,) = experiments([*own, *reference_results(own, rows)])
    labels = {curve.label: curve for curve in experiment.curves}
    assert list(labels) == ["2D-DVC, GOP 2", "JM 9.5 IPPP, zero motion", "JM 9.5 intra"]
    intra = labels["JM 9.5 intra"]
    assert intra.is_anchor
    assert intra.rates_kbps == pytest.approx([100.0, 200.0])
    assert intra.psnrs_y_db == [30.5, 33.5]


def test_reports_show_rows_and_do_not_count_them(rows: Path) -> None:
    """A report has curves of the rows; how many points were measured, and when, is told of ours."""
    own = [PointResult("a", result_data(60.0, 30.0))]
    results = [*own, *reference_results(own, rows)]
    assert preface(results) == preface(own)
    assert "JM 9.5 intra" in report_text(experiments(results), results, {"clip": "clip.png"})


def test_other_frames_have_no_rows(rows: Path) -> None:
    """Another start, another number of frames and colour are not what the rows were measured on."""
    for name, value in (("start", 1), ("luma_only", False)):
        data = result_data(60.0, 30.0)
        data["options"] = {**data["options"], name: value}
        assert reference_results([PointResult("a", data)], rows) == []
    longer = result_data(60.0, 30.0)
    longer["totals"] = {**longer["totals"], "frames": 5}
    assert reference_results([PointResult("a", longer)], rows) == []


def test_rows_that_stand_beside_nothing_are_told(
    rows: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report of points in colour says in one line that rows are of luma only."""
    folder = write_colour_results(tmp_path / "a")
    assert main(["report", str(folder), "--reference-rows", str(rows)]) == 0
    assert capsys.readouterr().err == (
        "dvc-rd: no reference rows of these frames; they are of luma only (run --luma-only)\n"
    )


def test_file_of_the_environment(rows: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a file there are no rows; the environment can name one."""
    own = [PointResult("a", result_data(60.0, 30.0))]
    monkeypatch.delenv(ROWS_VARIABLE, raising=False)
    assert reference_results(own) == []
    monkeypatch.setenv(ROWS_VARIABLE, str(rows))
    assert len(reference_results(own)) == 3


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n1,2\n",
        HEAD + "clip,jm95-intra,cabac,none,x,3,1,1,1\n",
        HEAD + "clip,jm95-intra,cabac,none,9,0,1,1,1\n",
        HEAD + "clip,jm95-intra,cabac,none,9,3,24000,240.0,inf\n",
        HEAD + "clip,jm95-intra,cabac,none,9,3,24000,240.0,nan\n",
        HEAD + f"clip,jm95-intra,cabac,none,9,3,{10**400},240.0,30.0\n",
        HEAD + "c" * 140_000,
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str) -> None:
    """A file of something else raises an error that names it."""
    path = tmp_path / "rows.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DvcError, match=r"rows\.csv: not a table of reference points"):
        read_reference_rows(path)
    with pytest.raises(DvcError, match=r"nowhere\.csv: cannot be read"):
        read_reference_rows(tmp_path / "nowhere.csv")


def test_shared_rows(shared_sequences: Path) -> None:
    """The rows beside the real sequences have six QPs of each mode for the three clips and foreman."""
    path = shared_sequences.parent / "anchors" / "h264.csv"
    if not path.is_file():
        pytest.skip(f"no rows in {path}")
    found = read_reference_rows(path)
    assert len(found) == 4 * 3 * 6
    assert {row.frames for row in found} == {51}
