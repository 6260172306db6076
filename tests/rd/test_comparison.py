"""Comparison of curves: differences, crossings, refusals, and the command."""

import csv
import io
import itertools
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import ConfigError, DvcError
from dvc.rd.__main__ import main
from dvc.rd.comparison import (
    CSV_COLUMNS,
    at_equal,
    compare,
    comparison_csv,
    comparison_table,
    find_label,
)
from dvc.rd.rd_curves import MEASURES, Curve, crossing_text, crossings_kbps
from dvc.rd.rd_report import table
from dvc.rd.rd_results import SequenceInfo, parse_result, read_results
from tests.rd.made_up import add_result, result_data, write_colour_results, write_results

CODEC, INTRA = "2D-DVC, GOP 2", "H.264 intra"


def _curve(*points: tuple[float, float]) -> Curve:
    results = (parse_result(str(i), result_data(*point)) for i, point in enumerate(points))
    return Curve("curve", False, tuple(results))


def test_curves_that_two_experiments_have_in_common(tmp_path: Path) -> None:
    """A tenth more rate everywhere is a BD-rate of +10 %; other frames have nothing in common."""
    before = read_results(write_results(tmp_path / "a"))
    after = read_results(write_results(tmp_path / "b", scale=1.1))
    text = table(*comparison_table(compare(before, after)))
    assert text.count("+10.0 %") == 2
    assert text.count("-0.") == 2
    assert text.count("worse at all common rates") == 2
    sequence = {**result_data(60.0, 30.0)["sequence"], "digest": "d2"}
    other = [parse_result("x", result_data(60.0, 30.0, sequence=sequence))]
    with pytest.raises(DvcError, match="no codec and sequence in common"):
        compare(before, other)


def test_curves_within_an_experiment(tmp_path: Path) -> None:
    results = read_results(write_results(tmp_path / "a"))
    (one,) = compare(results)
    assert (one.other.label, one.reference.label) == (CODEC, INTRA)
    assert not isinstance(one.rates["luma"], str)
    assert one.rates["luma"].value == pytest.approx(-20.0)
    (back,) = compare(results, against="2d")
    assert not isinstance(back.rates["luma"], str)
    assert back.rates["luma"].value == pytest.approx(25.0)
    (pair,) = compare(results, curves=("intra", "2D-DVC"))
    assert (pair.sequence, pair.other.label, pair.reference.label) == ("clip", CODEC, INTRA)


def test_all_curves_of_an_experiment_against_one_of_another(tmp_path: Path) -> None:
    """With a label, every curve of the second experiment is compared with that curve of the first."""
    before = read_results(write_results(tmp_path / "a"))
    after = read_results(write_results(tmp_path / "b", scale=1.1))
    rows = compare(before, after, against=INTRA)
    assert [row.other.label for row in rows] == [CODEC, INTRA]
    rates = [row.rates["luma"].value for row in rows if not isinstance(row.rates["luma"], str)]
    assert rates == pytest.approx([-12.0, 10.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"curves": ("intra", "4D")}, "no curve with '4D'; expected one of: 2D-DVC, GOP 2; H.264 intra"),
        ({"against": "2"}, "several curves with '2'"),
        ({"curves": ("intra", "H.264")}, "are the same curve"),
        ({"curves": ("a", "b"), "after": []}, "give one folder"),
    ],
)
def test_labels_that_say_nothing_are_refused(tmp_path: Path, arguments: dict[str, Any], message: str) -> None:
    results = read_results(write_results(tmp_path / "a"))
    with pytest.raises(ConfigError, match=message):
        compare(results, **arguments)


def test_a_whole_label_is_found_although_it_is_part_of_another(tmp_path: Path) -> None:
    data = result_data(60.0, 30.0)
    longer = {**data, "options": {**data["options"], "options": {"seed": "2"}}}
    results = [parse_result("a", data), parse_result("b", longer)]
    assert find_label(results, CODEC) == CODEC
    assert find_label(results, "SEED") == f"{CODEC}, seed 2"


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([(50.0, 30.0), (200.0, 36.0)], "better at all common rates"),
        ([(50.0, 20.0), (200.0, 26.0)], "worse at all common rates"),
        ([(50.0, 30.0), (200.0, 34.0)], "better up to 100 kbit/s"),
        ([(50.0, 28.0), (200.0, 36.0)], "better from 100 kbit/s"),
        ([(300.0, 30.0), (400.0, 34.0)], "no rates in common"),
        ([(70.0, 30.0)], "a curve of one point"),
        ([(50.0, 29.0), (200.0, 35.0)], "equal at all common rates"),
        # The better of two points counts if their rates differ by rounding.
        ([(50.0, 29.0), (200.0, 34.0), (200.00000000000003, 35.0)], "equal at all common rates"),
    ],
)
def test_where_a_curve_is_better(points: list[tuple[float, float]], text: str) -> None:
    reference = _curve((50.0, 29.0), (200.0, 35.0))
    assert crossing_text(reference, _curve(*points)) == text


def test_several_crossings() -> None:
    line = _curve((50.0, 30.0), (100.0, 32.0), (200.0, 34.0))
    bent = _curve((50.0, 29.0), (100.0, 33.0), (200.0, 33.5))
    inside, outside = crossing_text(line, bent), crossing_text(bent, line)
    (_, first), (low, _), (high, _) = crossings_kbps(line, bent)
    assert not first
    assert inside == f"better from {low:.0f} up to {high:.0f} kbit/s"
    assert outside == f"better up to {low:.0f} and from {high:.0f} kbit/s"


@given(
    st.lists(st.tuples(st.floats(1, 1e4), st.floats(10, 60)), min_size=1, max_size=6),
    st.lists(st.tuples(st.floats(1, 1e4), st.floats(10, 60)), min_size=1, max_size=6),
)
def test_crossings_of_any_curves(a: list[tuple[float, float]], b: list[tuple[float, float]]) -> None:
    pieces = crossings_kbps(_curve(*a), _curve(*b))
    rates = [rate for rate, _ in pieces]
    assert rates == sorted(rates)
    assert all(one[1] != other[1] for one, other in itertools.pairwise(pieces))
    assert all(math.isfinite(rate) and 0.99 <= rate <= 1.01e4 for rate in rates)


def test_csv_of_comparisons(tmp_path: Path) -> None:
    folder = write_results(tmp_path / "a")
    single = result_data(61.0, 30.0)
    single["options"] = {**single["options"], "gop": 8}
    add_result(folder, "single", single)
    rows = list(csv.DictReader(io.StringIO(comparison_csv(compare(read_results(folder))))))
    assert list(rows[0]) == list(CSV_COLUMNS)
    document = (Path(__file__).parents[2] / "docs" / "rd.md").read_text(encoding="utf-8")
    assert all(f"`{column}`" in document for column in CSV_COLUMNS)
    good, refused = rows
    assert float(good["bd_rate_percent"]) == pytest.approx(-20.0)
    assert (good["num_points"], good["num_points_against"], good["refused"]) == ("3", "3", "")
    assert refused["bd_rate_percent"] == ""
    assert "1 useful points" in refused["refused"]


def test_compare_command(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = write_results(tmp_path / "a"), write_results(tmp_path / "b", 0.9)
    assert main(["compare", str(a), str(b), "--csv", str(tmp_path / "c.csv")]) == 0
    printed = capfd.readouterr().out
    head = "| sequence | codec | against | BD-rate (overlap, points) | BD-PSNR | PSNR at equal rate |"
    assert printed.splitlines()[0] == head
    assert printed.count("-10.0 %") == 2
    assert len((tmp_path / "c.csv").read_text(encoding="utf-8").splitlines()) == 3
    assert main(["compare", str(a), "--curves", "intra", "2d", "--csv", "-"]) == 0
    assert capfd.readouterr().out.startswith("sequence,codec,against,")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["compare", str(a)]) == 0
    assert "┃" in capfd.readouterr().out


def test_nothing_comparable_is_an_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Curves without a common range are refused with the reason, and the exit status is 2 if all are."""
    folder = tmp_path / "a"
    for number, (rate_kbps, psnr_y_db) in enumerate([(60.0, 29.0), (90.0, 31.0)]):
        add_result(folder, f"a{number}", result_data(rate_kbps, psnr_y_db))
        add_result(folder, f"b{number}", result_data(9 * rate_kbps, psnr_y_db + 9, codec="h264-intra"))
    assert main(["compare", str(folder)]) == 2
    captured = capfd.readouterr()
    assert "not comparable: the curves have no" in captured.out
    assert captured.err.count("\n") == 1
    add_result(folder, "c", result_data(600.0, 37.0))
    assert main(["compare", str(folder)]) == 0


def test_curves_are_compared_at_other_qualities(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Curves are compared by mean squared error, or with chroma (weight one quarter) if it was measured."""
    data = result_data(60.0, 30.0)
    totals = {**data["totals"], "psnr_yuv_db": 32.75}
    frames = [{"type": "key", "psnr_y_db": 40.0}, {"type": "wz", "psnr_y_db": 20.0}]
    full = parse_result("x", {**data, "totals": totals, "per_frame": frames})
    points = {quality: at_equal([full], quality)[0] for quality in ("luma", "mse", "colour")}
    found = {quality: point.psnr_y_db for quality, point in points.items()}
    assert found["luma"] == 30.0
    assert found["mse"] == pytest.approx(10 * math.log10(2 / (1e-4 + 1e-2)))
    assert found["colour"] == 32.75
    assert all(point.totals.psnr_yuv_db is None for point in points.values())
    for quality, rows, message in (
        ("colour", [], "no chroma: `dvc-rd run` measures it without --luma-only"),
        ("mse", [], "no frames"),
        ("mse", [*frames, {"type": "wz", "psnr_y_db": None}], "x has a frame without PSNR"),
    ):
        with pytest.raises(ConfigError, match=message):
            at_equal([parse_result("x", {**data, "per_frame": rows})], quality)
    folder = write_results(tmp_path / "a")
    assert main(["compare", str(folder)]) == 0
    usual = capsys.readouterr().out
    assert main(["compare", str(folder), "--quality", "luma"]) == 0
    assert capsys.readouterr().out == usual


def test_curves_are_compared_by_luma_and_in_colour(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_colour_results(tmp_path / "a")
    (one,) = compare(read_results(folder))
    values = [getattr(one.rates[measure], "value", None) for measure in MEASURES]
    assert values == pytest.approx([-20.0, 0.0], abs=1e-6)
    (row,) = csv.DictReader(io.StringIO(comparison_csv([one])))
    assert float(row["bd_rate_percent"]) == pytest.approx(-20.0)
    assert float(row["bd_rate_yuv_percent"]) == pytest.approx(0.0, abs=1e-6)
    assert float(row["bd_psnr_yuv_db"]) == pytest.approx(0.0, abs=1e-6)
    assert main(["compare", str(folder)]) == 0
    head, _, line = capsys.readouterr().out.splitlines()
    assert "| BD-rate, luma (overlap, points) | BD-rate, colour (overlap, points) |" in head
    assert "| BD-PSNR, luma | BD-PSNR, colour | luma PSNR at equal rate |" in head
    assert re.search(r"-20\.0 % \(.*?\) \| [+-]0\.0 % \(", line)
    results, other = read_results(folder), SequenceInfo("other", "d2", 32, 16, 25.0)
    factors = {"2d": 0.5, "h264-intra": 1.0}
    moved = [
        replace(one, sequence=other, totals=replace(one.totals, rate_kbps=factors[one.codec] * one.rate_kbps))
        for one in results
    ]
    titles, rows = comparison_table(compare([*results, *moved]))
    mean = dict(zip(titles, rows[-1], strict=True))
    assert mean["BD-rate, luma (overlap, points)"] == "-40.0 % (2 of 2 sequences, -60.0 to -20.0 %)"
    assert mean["BD-rate, colour (overlap, points)"].startswith("-25.0 % (2 of 2 sequences, -50.0 to ")
    for quality, figure in (("luma", "-20.0 %"), ("colour", "0.0 %")):
        assert main(["compare", str(folder), "--quality", quality]) == 0
        head, _, line = capsys.readouterr().out.splitlines()
        assert "| BD-rate (overlap, points) | BD-PSNR |" in head
        assert figure in line
