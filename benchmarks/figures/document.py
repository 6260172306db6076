"""Rows of figures in a file, what replaces what, and the document that people read."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.figures import page, readme
from benchmarks.figures.definitions import all_units, digests
from benchmarks.figures.harness import Key, Row
from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output

DOCUMENT = Path("docs") / "figures.json"
README = Path("README.md")
ORIGIN = ("code", "machine", "before")
"""Entries that rows of earlier versions have not."""


def row_key(row: Row) -> Key:
    """Return what tells a row from all others."""
    return row["area"], row["name"], row["clip"]


def is_failure(row: Row) -> bool:
    """Tell whether the last attempt to measure a row failed."""
    return row["got"] is None and row["holds"] is False


def read_rows(path: Path) -> list[Row]:
    """Read rows; the inverse of `write_rows`."""
    if not path.exists():
        return []
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return [row | {name: row.get(name) for name in ORIGIN} for row in rows if row_key(row)]
    except (ValueError, TypeError, KeyError) as err:
        raise DvcError(f"{path}: damaged: {err!r}") from err


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cli.write_json(path, list(rows))


def merged_rows(old: Sequence[Row], new: Sequence[Row]) -> list[Row]:
    """Put new rows in the place of old ones."""
    rows = {row_key(row): row for row in old}
    for row in new:
        known = rows.get(row_key(row))
        if is_failure(row):
            rows[row_key(row)] = row | {"before": _before(known)}
        elif row["got"] is not None or known is None or not (known["got"] or is_failure(known)):
            rows[row_key(row)] = row
    merged = []
    for unit in all_units():
        today = unit.figure.row(unit.clip, None, "not measured yet")
        row = rows.get(unit.key, today)
        words = {name: today[name] for name in ("title", "asked", "thesis")}
        if row["got"] is None and not is_failure(row):
            row = today | {"note": row["note"]}
        elif row["asked"] != words["asked"]:
            row = row | {"code": None}
        merged.append(row | words)
    return merged


def _before(row: Row | None) -> str | None:
    """Return what stood in a row before a measurement that failed."""
    if row is None or row["got"] is None:
        return None if row is None else row["before"]
    return f"{row['got']} ({row['date']})"


def document_text(rows: Sequence[Row], now: Mapping[Key, str] | None = None) -> str:
    """Return the document that people read."""
    found = digests() if now is None else now
    return page.text([page.Entry(row, found.get(row_key(row))) for row in rows])


def write_document(new: Sequence[Row]) -> None:
    """Enter new rows into both files of the document, and into the README."""
    rows = merged_rows(read_rows(DOCUMENT), new)
    write_rows(DOCUMENT, rows)
    texts = {DOCUMENT.with_suffix(".md"): document_text(rows)}
    if README.exists():
        texts[README] = readme.with_measured(README.read_text(encoding="utf-8"), rows)
    for path, text in texts.items():
        with atomic_output(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
