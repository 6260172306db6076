"""The figures that are defined, and the document in `docs`."""

from pathlib import Path

from benchmarks.figures.definitions import all_units
from benchmarks.figures.document import document_text, read_rows, row_key

DOCUMENT = Path(__file__).parents[3] / "docs" / "figures.json"


def test_figures_have_names_of_their_own() -> None:
    """No two rows have the same area, name and clip."""
    keys = [unit.key for unit in all_units()]
    assert len(keys) == len(set(keys))


def test_document_has_the_rows_that_are_defined() -> None:
    """Every figure and clip has its row, measured or with a reason why not, and there are no others."""
    rows = {row_key(row): row for row in read_rows(DOCUMENT)}
    assert list(rows) == [unit.key for unit in all_units()]
    for unit in all_units():
        row, defined = rows[unit.key], unit.figure.row(unit.clip, None)
        assert row["command"].removesuffix(f" --frames {row['command'].split()[-1]}") == defined["command"]
        assert (row["asked"], row["thesis"]) == (defined["asked"], defined["thesis"])
        assert row["got"] is not None or row["note"]


def test_document_for_people_is_that_of_the_rows() -> None:
    """What people read was made of the rows, and not edited."""
    assert DOCUMENT.with_suffix(".md").read_text(encoding="utf-8") == document_text(read_rows(DOCUMENT))
