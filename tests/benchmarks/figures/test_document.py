"""The document of figures: which rows there are, what replaces what, how an interrupted run goes on."""

import json
import platform
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.figures import __main__ as command
from benchmarks.figures import definitions, document
from benchmarks.figures.harness import Figure, Measured, MissingClip, Setting, run_module
from dvc.errors import ConfigError, DvcError


def _figure(name: str, clips: tuple[str | None, ...] = (None,), error: Exception | None = None) -> Figure:
    def measure(_setting: Setting, clip: str) -> Measured:
        if error is not None:
            raise error
        return Measured(f"{name} {clip}", True, {"value_s": 1.0})

    return Figure("area", name, f"title of {name}", "≤ 1 s", measure, clips)


@pytest.fixture(autouse=True)
def somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder of its own, with two figures of which one is per clip."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").mkdir()

    class _Module:
        FIGURES = (_figure("one"), _figure("two", ("a", "b")))

    monkeypatch.setattr(definitions, "MODULES", (_Module,))


def _document() -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads(Path("docs/figures.json").read_text(encoding="utf-8"))
    return rows


def _page() -> str:
    return Path("docs/figures.md").read_text(encoding="utf-8")


def test_every_row_is_measured_and_written(capsys: pytest.CaptureFixture[str]) -> None:
    """A run writes a row for every figure and clip, and the document that people read."""
    assert command.main([]) == 0
    assert [(row["name"], row["clip"], row["holds"]) for row in _document()] == [
        ("one", None, True),
        ("two", "a", True),
        ("two", "b", True),
    ]
    assert _document()[1]["command"] == "python -m benchmarks.figures --area area --name two --clip a"
    assert "| title of two | b | ≤ 1 s | two b | yes |" in _page()
    assert "area/two a: two a; asked ≤ 1 s: holds" in capsys.readouterr().out


def test_rows_never_measured_are_there() -> None:
    """A part of the figures leaves rows for the others that say so."""
    assert command.main(["--name", "one"]) == 0
    assert [row["got"] for row in _document()] == ["one ", None, None]
    assert "*not measured yet*" in _page()


def test_rows_follow_their_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """All rows have today's words; one that was measured when something else was asked is stale."""
    assert command.main([]) == 0
    first, second = definitions.MODULES[0].FIGURES
    changed = (replace(first, title="new"), replace(second, asked="≤ 2 s"), _figure("three"))
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", changed)
    assert command.main(["--name", "three"]) == 0
    assert [row["title"] for row in _document()] == ["new", *["title of two"] * 2, "title of three"]
    assert [row["asked"] for row in _document()] == ["≤ 1 s", "≤ 2 s", "≤ 2 s", "≤ 1 s"]
    assert [row["code"] is None for row in _document()] == [False, True, True, False]
    assert "| new |  | ≤ 1 s | one  | yes |" in _page()
    assert "| title of two | a | ≤ 2 s | two a | stale: yes |" in _page()


def test_quick_run_keeps_nothing() -> None:
    """With --quick only the first clip is measured, and no document is written."""
    assert command.main(["--quick"]) == 0
    assert not list(Path("docs").iterdir())
    assert len(definitions.selected_units(None, None, None, quick=True)) == 2


def test_missing_clip_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row whose clip is missing says so, and does not replace an older measurement."""
    missing = _figure("two", ("a", "b"), MissingClip("not measured: no sequence 'a'"))
    assert command.main(["--name", "two", "--clip", "b"]) == 0
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", (missing,))
    assert command.main([]) == 0
    first, second = _document()
    assert (first["got"], first["holds"], first["note"]) == (None, None, "not measured: no sequence 'a'")
    assert second["got"] == "two b"


@pytest.mark.parametrize("error", [DvcError("no\nroom"), OSError("no room"), AssertionError("no room")])
def test_failed_measurements_lose_their_verdict(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """A row says that it failed, when and why; what was measured before is text, and counts no more."""
    assert command.main([]) == 0
    date = _document()[0]["date"]
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", (_figure("one", error=error), _figure("two")))
    for _ in range(2):
        assert command.main(["--name", "one"]) == 2
        [row, _] = _document()
        assert (row["got"], row["holds"], row["values"]) == (None, False, {})
        assert row["date"] == date
        assert row["note"].startswith("the measurement failed: ")
        assert row["note"].endswith("no room")
        assert row["before"] == f"one  ({date})"
        assert row["code"]
    assert f"no room; before: one  ({date})* | **failed** | {date} |" in _page()
    assert " 1 failed," in _page()
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", (_figure("one"), _figure("two")))
    assert command.main(["--name", "one"]) == 0
    assert (_document()[0]["got"], _document()[0]["before"]) == ("one ", None)


def test_rows_of_other_code_are_stale() -> None:
    """A row is stale if the code has moved since, or if it is not known which code it was."""
    assert command.main([]) == 0
    rows = _document()
    now = {document.row_key(row): row["code"] for row in rows}
    rows[1]["code"], rows[1]["holds"] = "other", False
    rows[2]["code"], rows[2]["holds"] = None, None
    page = document.document_text(rows, now)
    assert "| one  | yes |" in page
    assert "| two a | stale: **no** |" in page
    assert "| two b | stale |" in page
    assert "1 do not hold, 0 failed, 0 are not measured yet, 2 are stale, 1 of these of unknown code" in page


def test_rows_say_where_they_come_from() -> None:
    """Every row has the digest of its code and the kind of machine, which is not named."""
    assert command.main([]) == 0
    for row in _document():
        assert len(row["code"]) == 32
        assert re.fullmatch(r".+, \d+ cores?", row["machine"])
        assert platform.node() not in row["machine"]


def test_interrupted_run_goes_on(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """What was measured before a failure is not measured again; after a complete run everything is."""
    broken = (_figure("one"), _figure("two", ("a",), DvcError("broken")))
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", broken)
    assert command.main([]) == 2
    assert "the measurement failed: broken" in capsys.readouterr().out
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", (_figure("one"), _figure("two", ("a",))))
    assert command.main([]) == 0
    assert "area/one" not in capsys.readouterr().out
    assert command.main([]) == 0
    assert "area/one" in capsys.readouterr().out


def test_rows_of_figures_that_are_gone_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """A figure that is not defined any more leaves the document."""
    assert command.main([]) == 0
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", (_figure("one"),))
    assert command.main([]) == 0
    assert [row["name"] for row in _document()] == ["one"]


def test_slow_measurements_are_not_tried_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quick run leaves out what cannot be quick, unless it is named."""
    figures = (_figure("one"), replace(_figure("two"), slow=True))
    monkeypatch.setattr(definitions.MODULES[0], "FIGURES", figures)
    for name, quick, count in ((None, True, 1), ("two", True, 1), (None, False, 2)):
        assert len(definitions.selected_units(None, name, None, quick)) == count


def test_unknown_figures_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """An area that does not exist is refused with one line that lists them."""
    assert command.main(["--area", "cooking"]) == 2
    assert "areas are area" in capsys.readouterr().err
    with pytest.raises(ConfigError):
        definitions.selected_units("area", "one", "a", quick=False)


def test_damaged_document_is_refused() -> None:
    """A document that is no list of rows raises DvcError that names it."""
    path = Path("rows.json")
    for text in ("{", "[1]", '[{"area": 1}]', "3"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(DvcError, match=r"rows\.json"):
            document.read_rows(path)


def test_usage_is_that_of_the_process() -> None:
    """Peak memory is at least what a process allocates, and far below that plus ours; a failure is told."""
    small = run_module("timeit", ["-n", 1, "-r", 1, "bytes(1)"])
    large = run_module("timeit", ["-n", 1, "-r", 1, "len(bytearray(b'x') * 10**8)"])
    assert 0.9e8 < large.peak_bytes - small.peak_bytes < 1.2e8
    assert large.wall_s > 0
    with pytest.raises(DvcError, match="ended with status"):
        run_module("timeit", ["--nonsense"])


def test_long_measurements_want_to_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A figure that takes long is measured only where its name is given; its row is there all the same."""
    monkeypatch.setattr(
        definitions.MODULES[0], "FIGURES", (_figure("one"), replace(_figure("two"), on_request=True))
    )
    assert command.main([]) == 0
    assert [row["got"] for row in _document()] == ["one ", None]
    assert command.main(["--name", "two"]) == 0
    assert [row["got"] for row in _document()] == ["one ", "two "]
