"""Numbers in documents are those of results."""

from pathlib import Path

import pytest

from benchmarks.results.document import read_document
from benchmarks.results.fill import documents, filled, unmarked
from dvc.errors import ConfigError

ENTRIES = {
    "rate/intra": {"name": "rate/intra", "digest": "a", "text": "−70.7 %", "by_clip": {"box": -71.23}},
}


@pytest.mark.parametrize("path", documents(), ids=lambda path: path.name)
def test_documents_tell_the_numbers_of_results(path: Path) -> None:
    """Every marked number is that of its result, or says that there is none; `--fill` writes it."""
    text = path.read_text(encoding="utf-8")
    assert filled(text, read_document()) == text, "run python -m benchmarks.results --fill"


@pytest.mark.parametrize("path", documents(), ids=lambda path: path.name)
def test_documents_tell_no_other_measured_numbers(path: Path) -> None:
    assert list(unmarked(path.read_text(encoding="utf-8"))) == []


def test_marks_are_filled_in_again_and_again() -> None:
    """The value goes between the marks, of all clips or of one; a missing result is named."""
    text = "a <!-- row:rate/intra --> x <!-- / --> b <!-- row:rate/intra:box --><!-- / --> "
    text += "<!-- row:rate/2d --> 1 % <!-- / -->"
    once = filled(text, ENTRIES)
    assert once == (
        "a <!-- row:rate/intra --> −70.7 % <!-- / --> b <!-- row:rate/intra:box --> −71.2 % <!-- / --> "
        "<!-- row:rate/2d --> not measured with this code <!-- / -->"
    )
    assert filled(once, ENTRIES) == once


@pytest.mark.parametrize("mark", ["rate/nothing", "rate/intra:nowhere"])
def test_marks_of_nothing_are_refused(mark: str) -> None:
    with pytest.raises(ConfigError, match=r"nothing|nowhere"):
        filled(f"<!-- row:{mark} --> <!-- / -->", ENTRIES)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("it needs −4.5 % less", 1),
        ("38.2 dB at 120 kbit/s", 2),
        ("some 15 % fewer", 1),
        ("takes 0.65 ms a frame", 1),
        ("<!-- row:rate/intra --> −70.7 % <!-- / --> less", 0),
        ("<!-- given -->90 %<!-- / --> of the points", 0),
        ("`--quality 30 %` and 49 frames, QP 28", 0),
        ("```\n12 %\n```", 0),
    ],
)
def test_numbers_that_look_measured_are_found(text: str, count: int) -> None:
    assert len(list(unmarked(text))) == count
