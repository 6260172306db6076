"""The figures that are defined, and the document in `docs`."""

from functools import partial
from pathlib import Path

from benchmarks.figures.claims import CLAIMS
from benchmarks.figures.definitions import all_units, digests
from benchmarks.figures.document import document_text, is_failure, read_rows, row_key
from benchmarks.figures.harness import STATIC_CLIPS

ROOT = Path(__file__).parents[3]
DOCUMENT = ROOT / "docs" / "figures.json"


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
        assert all(row[word] == defined[word] for word in ("title", "asked", "thesis"))
        assert row["got"] is not None or row["note"]
        assert (row["date"] is not None) == (row["got"] is not None or is_failure(row))


def test_document_for_people_is_that_of_the_rows() -> None:
    """What people read was made of the rows and tells which are stale; `--page` makes it again."""
    found = DOCUMENT.with_suffix(".md").read_text(encoding="utf-8")
    assert found == document_text(read_rows(DOCUMENT)), "run python -m benchmarks.figures --page"


def test_claims_name_rows_and_documents() -> None:
    """Every claim has rows that are defined, and documents that are there; none is made twice."""
    names = {(unit.figure.area, unit.figure.name) for unit in all_units()}
    assert {name for claim in CLAIMS for name in claim.rows} <= names
    assert all((ROOT / path).is_file() for claim in CLAIMS for path in claim.where)
    assert len({claim.says for claim in CLAIMS}) == len(CLAIMS) <= 35
    assert all(claim.rows for claim in CLAIMS)


def test_means_are_over_all_clips() -> None:
    """No mean over several of the static clips leaves one of them out, unless nothing is known of it."""
    for unit in all_units():
        clips = (
            unit.figure.measure.keywords.get("clips") if isinstance(unit.figure.measure, partial) else None
        )
        if clips and unit.clip is None:
            assert set(STATIC_CLIPS) <= set(clips), unit.key


def test_every_row_has_a_digest() -> None:
    """Rows of one figure have one digest, those of others have others, and it follows what they are told."""
    found = digests()
    assert set(found) == {unit.key for unit in all_units()}
    by_name = {(area, name): digest for (area, name, _), digest in found.items()}
    assert all(by_name[area, name] == digest for (area, name, _), digest in found.items())
    assert len(set(by_name.values())) > 0.9 * len(by_name)
    assert by_name["turbo", "efficiency-0.01"] != by_name["turbo", "efficiency-0.03"]
