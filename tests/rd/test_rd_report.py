"""Curves, tables, plots and comparisons from results."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dvc.rd.comparison import bd_rate_text, rate_costs
from dvc.rd.rd_curves import compare_curves, experiments
from dvc.rd.rd_report import points_cells, rates_text, table, write_report
from dvc.rd.rd_results import PointResult, parse_result, read_results
from dvc.rd.specification import NO_FEEDBACK
from tests.rd.made_up import result_data, write_colour_results, write_results
from tests.rd.made_up_page import HOSTILE

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def test_results_are_sorted_into_experiments_and_curves(tmp_path: Path) -> None:
    (experiment,) = experiments(read_results(write_results(tmp_path / "a")))
    assert [curve.label for curve in experiment.curves] == ["2D-DVC, GOP 2", "H.264 intra"]
    assert experiment.curves[0].rates_kbps == [60.0, 90.0, 200.0]
    assert experiment.anchor() is experiment.curves[1]
    assert experiment.title == "clip: 64×48, frames 0 to 2 at 25 Hz, luma only"


def test_other_frames_and_options_are_separated() -> None:
    """Another length is another experiment, other options another curve; names of files stay unique."""
    plain = result_data(60.0, 30.0)
    longer = result_data(60.0, 30.0)
    longer["totals"] = {**longer["totals"], "frames": 5}
    hierarchical = result_data(60.0, 30.0)
    hierarchical["options"] = {
        **hierarchical["options"],
        "options": {"references": "hierarchical", "seed": "2"},
    }
    chosen = {**plain, "options": {**plain["options"], "key_qp": "30"}}
    results = [parse_result(str(i), data) for i, data in enumerate((plain, longer, hierarchical, chosen))]
    short, long = experiments(results)
    assert [curve.label for curve in short.curves] == [
        "2D-DVC, GOP 2",
        "2D-DVC, GOP 2, chosen key QPs",
        "2D-DVC, GOP 2, references hierarchical, seed 2",
    ]
    assert short.slug != long.slug


def test_tables_leave_out_empty_columns(tmp_path: Path) -> None:
    """Columns about Wyner-Ziv frames are there for the codec, and not for the intra anchor."""
    (experiment,) = experiments(read_results(write_results(tmp_path / "a")))
    reference = experiment.curves[1]
    difference = compare_curves(reference, experiment.curves[0])
    assert bd_rate_text(difference) == "-20.0 % (29.0 to 35.0 dB, 3 and 3 points)"
    codec, intra = (table(*points_cells(curve)) for curve in experiment.curves)
    assert "| level | key QP |" in codec
    assert "| Q1 | 34 | 60.0 | 29.00 |" in codec
    assert "decode s per WZ frame" in codec
    assert "WZ" not in intra
    assert "| 75.0 | 0.0 | 20.0 |" not in intra


@pytest.mark.parametrize(
    ("cell", "shown"), [("x|y", "x\\|y"), ("<b>", "&lt;b>"), ("<script>", "&lt;script>"), ("a\nb", "a b")]
)
def test_cells_are_plain_text(cell: str, shown: str) -> None:
    assert table([cell], [[cell]]) == f"| {shown} |\n| --- |\n| {shown} |\n"


def test_report_has_tables_and_pictures(tmp_path: Path) -> None:
    """The report names its pictures, a PNG and a well-formed SVG, and is the same when made again."""
    results = read_results(write_results(tmp_path / "a"))
    written = write_report(results, [tmp_path / "report.md"], folder=tmp_path)
    stems = ["report-clip.png", "report-clip.svg"]
    stems += ["report-rate-against-cost.png", "report-rate-against-cost.svg"]
    assert [path.name for path in written] == stems
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "(report-clip.png)" in text
    assert "](report-rate-against-cost.png)" in text
    assert "| 2D-DVC, GOP 2 | 1.00 | -20.0 % | 1 |" in text
    assert "-20.0 %" in text
    pairs = text.split("## Every curve against every other")[1].split("\n## ")[0]
    assert "<summary>Against 2D-DVC, GOP 2</summary>\n\n| sequence | H.264 intra |" in pairs
    assert "| clip | +25.0 % |" in pairs
    assert "python -m encoder clip.mkv stream.dvc" in text
    assert written[0].read_bytes().startswith(PNG_MAGIC)
    svg = ET.parse(written[1]).getroot()
    assert any("H.264 intra" in (element.text or "") for element in svg.iter())
    written.append(tmp_path / "report.md")
    before = [path.read_bytes() for path in written]
    write_report(results, [tmp_path / "report.md"], folder=tmp_path)
    assert [path.read_bytes() for path in written] == before
    write_report([one for one in results if one.codec == "2d"], [tmp_path / "b.md"], folder=tmp_path)
    assert "Rate against cost" not in (tmp_path / "b.md").read_text(encoding="utf-8")


def test_names_and_commands_are_no_markup(tmp_path: Path) -> None:
    data = result_data(60.0, 30.0, commands=["````", "# title", HOSTILE])
    data["sequence"]["name"] = f"{HOSTILE}\n# title"
    data["code"]["commit"] = HOSTILE
    write_report([parse_result("a", data)], [tmp_path / "r.md"], folder=tmp_path)
    shown, block = (tmp_path / "r.md").read_text(encoding="utf-8").split("<details>")
    assert "<" not in shown
    assert "\n# title" not in shown
    assert "| 2D-DVC, GOP 2 | – |" in shown  # one point without an anchor
    fence = "`" * 5
    assert block.count(fence) == 2
    assert HOSTILE in block.split(fence)[1]


def _proven(data: dict[str, Any], proof: dict[str, Any], **options: str) -> PointResult:
    return parse_result("a", {**data, "proof": proof, "options": {**data["options"], "options": options}})


def test_text_counts_proven_streams() -> None:
    """The text has the number of streams that a fresh process decoded; streams without feedback are files."""
    data = result_data(60.0, 30.0)
    yes = _proven(data, {"fresh_decode_equal": True})
    no = _proven(data, {"fresh_decode_equal": None})
    whole = _proven(data, {"file_bytes": 1000}, **{NO_FEEDBACK: "true"})
    assert "; a fresh process decoded each to the same frames. Rates of other" in rates_text([yes, yes])
    assert "; a fresh process decoded 1 of 2 to the same frames. Rates" in rates_text([yes, no])
    assert "; none was decoded again. Rates" in rates_text([no])
    both = "Rates of distributed codecs without feedback are sizes of the encoder's own files."
    assert rates_text([whole]) == f"{both} Rates of other codecs are sizes of whole files."
    assert both in rates_text([yes, whole])


def test_rate_costs_are_means_over_common_sequences(tmp_path: Path) -> None:
    results = read_results(write_results(tmp_path / "a"))
    times = {"2d": 0.006, "h264-intra": 0.003}
    results = [replace(one, times=replace(one.times, coding_cpu_s=times[one.codec])) for one in results]
    elsewhere = replace(results[0].sequence, name="other", digest="d2")
    other = [replace(one, name=f"b{one.name}", sequence=elsewhere) for one in results[:3]]
    costs = rate_costs(experiments([*results, *other]))
    assert [(one.label, one.num_sequences) for one in costs] == [("H.264 intra", 1), ("2D-DVC, GOP 2", 1)]
    assert [one.cost_ms for one in costs] == pytest.approx([1.0, 2.0])
    assert [one.bd_rate_percent for one in costs] == pytest.approx([0.0, -20.0])
    assert rate_costs(experiments(results), "no such curve") == []


def test_report_shows_luma_and_colour(tmp_path: Path) -> None:
    results = read_results(write_colour_results(tmp_path / "a"))
    (experiment,) = experiments(results)
    assert experiment.title.endswith(", colour")
    write_report(results, [tmp_path / "report.md"], folder=tmp_path)
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "PSNRs are means of frames: of luma, and in colour (6 Y + Cb + Cr) / 8." in text
    heads = [line for line in text.splitlines() if "BD-rate against" in line and line.startswith("| ")]
    assert (
        "| BD-rate against H.264 intra, luma (overlap, points) | BD-rate against H.264 intra, colour"
        in heads[0]
    )
    assert "| BD-rate against H.264 intra, luma | BD-rate against H.264 intra, colour |" in heads[1]
    assert re.search(r"\| clip \| 2D-DVC, GOP 2 \| -20\.0 % \(.*?\) \| [+-]0\.0 % \(", text)
    assert re.search(r"\| 2D-DVC, GOP 2 \| 1\.00 \| -20\.0 % \| [+-]0\.0 % \| 1 \|", text)
    assert "| sequence | 2D-DVC, GOP 2: luma | 2D-DVC, GOP 2: colour |" in text
    assert "| luma PSNR [dB] | colour PSNR [dB] |" in text
    assert "| Q1 | 34 | 60.0 | 29.00 | 31.50 |" in text
    assert "colour" not in table(
        *points_cells(experiments([parse_result("a", result_data(60.0, 30.0))])[0].curves[0])
    )
    svg = (tmp_path / "report-clip.svg").read_text(encoding="utf-8")
    assert re.search(r"BD-rate [-−]20\.0 %, colour [+−-]0\.0 %", svg)
