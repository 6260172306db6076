"""The document of results, freshness, and the page."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.results import document
from benchmarks.results.document import (
    DOCUMENT,
    PAGE,
    is_current,
    kept,
    page_text,
    read_document,
    still_holds,
)
from benchmarks.results.harness import Measured
from benchmarks.results.rows import BY_NAME, ROWS

MISSED, MET, FREE, ABSENT = "rate/x264-ippp", "rate/intra", "rate/svtav1-6", "hostile/harm"


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Make results up: one of each state, with canaries that are alike."""
    monkeypatch.setattr(document, "code_digest", lambda: "now")
    monkeypatch.setattr(document, "canary", lambda name: f"bytes of {name}")
    values = {MISSED: {"box": 10.0, "tree": 30.0}, MET: {"box": -80.0}, FREE: {"box": 33.0}}
    return {
        name: document.entry_of(BY_NAME[name], Measured(sum(by.values()) / len(by), by, 49), 60.0)
        for name, by in values.items()
    }


def test_rows_are_few_and_have_names_of_their_own() -> None:
    """At most 45 results have distinct names and titles."""
    assert len(BY_NAME) == len(ROWS) <= 45
    assert len({row.title for row in ROWS}) == len(ROWS)


def test_documents_are_read_as_they_were_written(entries: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    document.write_document({"gone": {}, **dict(reversed(entries.items()))}, path)
    assert read_document(path) == entries
    assert list(read_document(path)) == [row.name for row in ROWS if row.name in entries]


def test_page_shows_missed_targets_first_and_what_is_absent(entries: dict[str, Any]) -> None:
    """Missed, met and free results have headings of their own, in this order, absent ones last."""
    text = page_text(entries)
    places = [
        text.index(f"## {title}\n")
        for title in ("Target missed", "Target met", "No target", "Not measured with this code")
    ]
    assert places == sorted(places)
    assert "| +20.0 % (+10.0 % to +30.0 %) | ≤ +10.0 % | 2, 49 | `rate/x264-ippp`" in text
    assert places[0] < text.index(f"`{MISSED}`") < places[1] < text.index(f"`{MET}`") < places[2]
    assert text.index(f"`{ABSENT}`") > places[3]


def test_page_never_mixes_codes(entries: dict[str, Any]) -> None:
    entries[MET] |= {"digest": "then"}
    assert "−80.0" not in page_text(entries)
    assert f"* `{MET}`" in page_text(entries)


def test_results_are_kept_as_long_as_bytes_and_their_own_code_are_the_same(
    entries: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a change, rows with equal canaries are carried over and counted; the rest is dropped."""
    monkeypatch.setattr(document, "code_digest", lambda: "later")
    entries[MET]["canaries"] = {"default": "other bytes"}
    entries[FREE]["own_code"] = "another measurement"
    assert not any(is_current(entries[name], BY_NAME[name]) for name in entries)
    assert {name: still_holds(entries[name], BY_NAME[name]) for name in entries} == {
        MISSED: True,
        MET: False,
        FREE: False,
    }
    found = kept(entries)
    assert list(found) == [MISSED]
    assert found[MISSED]["digest"] == "later"
    assert found[MISSED]["measured_with"] == "now"
    assert "1 of these were measured with earlier code" in page_text(found)


def test_page_is_that_of_the_document() -> None:
    found = PAGE.read_text(encoding="utf-8")
    assert found == page_text(read_document(DOCUMENT)), "run python -m benchmarks.results --fill"


def test_targets_tell_what_is_met() -> None:
    row = BY_NAME[MISSED]
    assert row.at_most is not None
    assert (row.met(row.at_most), row.met(row.at_most + 0.1)) == (True, False)
    assert BY_NAME[FREE].met(1e9) is None
    least = BY_NAME["quality/side-information"]
    assert (least.met(5.9), least.met(6.1), least.target) == (False, True, "≥ +6.00 dB")
