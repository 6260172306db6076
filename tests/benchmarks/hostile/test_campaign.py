"""Campaigns: numbers are new, inputs are recorded by code, and repeated harm is stored."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from benchmarks.hostile import campaign, cuts
from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import Try
from benchmarks.hostile.campaign import FIRST, Tried
from benchmarks.results import hostile
from benchmarks.results.harness import Missing, Setting
from dvc.errors import DvcError


def test_parts_go_on_where_they_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = Tried.read(tmp_path / "state.json")
    first = tried.take(3)
    assert first.start >= FIRST
    tried.add("tables", 3, 1800.0, {"tables/7": "hang"}, {})
    again = Tried.read(tmp_path / "state.json")
    assert again == tried
    assert again.take(2).start == first.stop
    monkeypatch.setattr(campaign, "code_digest", lambda: "another")
    monkeypatch.setenv("NUMBA_BOUNDSCHECK", "1")
    again.add("tables", 2, 900.0, {}, {"tables/9": "hang"})
    again.add("maps", 1, 900.0, {}, {})
    assert (again.hours, again.inputs, again.finds) == (1.0, {"tables": 5, "maps": 1}, {"tables/7": "hang"})
    assert again.summary().endswith("without bounds checks, 3 with code another")


@pytest.mark.parametrize("text", ["[]", "{", '{"schema": "other"}', '{"schema": "dvc3d-tried/1"}'])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "state.json").write_text(text)
    with pytest.raises(DvcError, match=r"state\.json: "):
        Tried.read(tmp_path / "state.json")


def test_what_does_harm_twice_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:

    def run(tries: Sequence[Try]) -> list[str]:
        is_repeated = len(tries) < 9
        return [
            "hang" if (position == 0 if is_repeated else number % 20 == 0) else "refused"
            for position, (_, number) in enumerate(tries)
        ]

    monkeypatch.setattr(campaign, "run", run)
    monkeypatch.setattr(campaign, "SLICE_S", 1e9)
    monkeypatch.setattr(campaign, "_MOST", 40)
    tried = Tried(tmp_path / "state.json", 2000, [])
    monkeypatch.setattr(campaign.time, "monotonic", iter(range(0, 10**6, 600)).__next__)
    assert campaign.fuzz(tried, ["cameras"], 1.0, 1, tmp_path / "finds") == len(tried.finds) > 0
    kept = [f"cameras/{path.stem}" for path in sorted((tmp_path / "finds").glob("*/*"))]
    assert kept == sorted(tried.finds)
    assert (tmp_path / "finds" / f"{kept[0]}.bin").read_bytes() == kinds()["cameras"].damaged(2000)
    assert tried.parts[0].unsteady
    assert "hours, 40 inputs, 1 finds" in capsys.readouterr().out


def test_rows_tell_hours_finds_and_cuts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A find counts until it is mended, or where its file is gone; without a file there is no value."""
    monkeypatch.setattr(hostile, "FUZZING", tmp_path / "fuzzing.json")
    monkeypatch.setattr(hostile, "CUTS", tmp_path / "fuzzing.json")
    monkeypatch.setattr(hostile, "FINDS", tmp_path)
    with pytest.raises(Missing):
        hostile.hours_fuzzed(Setting())
    tried = Tried(tmp_path / "fuzzing.json", FIRST, [])
    tried.add("tables", 9, 7200.0, {"tables/1": "hang", "tables/2": "hang"}, {})
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "1.bin").write_bytes(kinds()["tables"].damaged(1))
    assert hostile.hours_fuzzed(Setting()).value == 2.0
    left, same = hostile.finds_left(Setting()), hostile.same_after_cuts(Setting())
    assert (left.value, left.note) == (1.0, "tables/2")
    assert same.value == 7.0
    assert "9 with code" in same.note


def test_cut_runs_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cuts, "run_module", lambda *_: None)
    monkeypatch.setattr(cuts, "prepared", lambda *_: {})
    monkeypatch.setattr(cuts, "run_number", lambda number, _: ("2d", "" if number % 2 else "a hang"))
    words = ["--state", str(tmp_path / "cuts.json"), "--out", str(tmp_path / "out"), "--runs"]
    assert cuts.main([*words, "4"]) == 1
    assert cuts.main([*words, "4"]) == 0
    assert cuts.main([*words, "5", "--hours", "0"]) == 0
    (part,) = json.loads((tmp_path / "cuts.json").read_text())["parts"]
    assert part["inputs"] == {"2d": 4}
    assert list(part["finds"].values()) == ["a hang"] * 2
    assert capsys.readouterr().out.count("of 4: ") == 4


@pytest.mark.slow
def test_cut_runs_are_those_of_uncut_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run without faults, one with faults, and one with another result, which is reported."""
    options = {"2d": ("--codec", "2d"), "faults": ("--codec", "2d")}
    monkeypatch.setattr(cuts, "OPTIONS", options)
    words = ["--state", str(tmp_path / "cuts.json"), "--out", str(tmp_path / "out"), "--frames", "4"]
    assert cuts.main([*words, "--runs", "2"]) == 0
    tried = Tried.read(tmp_path / "cuts.json")
    assert (tried.inputs, tried.finds) == (dict.fromkeys(options, 1), {})
    runs = cuts.prepared(tmp_path / "out" / "video.mkv", tmp_path / "out")
    other = {"2d": runs["2d"]._replace(expected=runs["2d"].expected._replace(video=b""))}
    assert cuts.run_number(3, other) == ("2d", "frames or bits are not those of an uncut run")
