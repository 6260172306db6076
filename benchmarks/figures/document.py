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
    """Return what tells a row from all others.

    Parameters
    ----------
    row : dict
        A row of the document.

    Returns
    -------
    tuple
        Area, name and clip.
    """
    return row["area"], row["name"], row["clip"]


def is_failure(row: Row) -> bool:
    """Tell whether the last attempt to measure a row failed.

    Parameters
    ----------
    row : dict
        A row of the document.

    Returns
    -------
    bool
        As opposed to a row that was never measured, and to one that was.
    """
    return row["got"] is None and row["holds"] is False


def read_rows(path: Path) -> list[Row]:
    """Read rows; the inverse of `write_rows`.

    Parameters
    ----------
    path : Path
        JSON file.

    Returns
    -------
    list of dict
        The rows; none if there is no such file.

    Raises
    ------
    DvcError
        If the file is damaged.
    """
    if not path.exists():
        return []
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return [row | {name: row.get(name) for name in ORIGIN} for row in rows if row_key(row)]
    except (ValueError, TypeError, KeyError) as err:
        raise DvcError(f"{path}: damaged: {err!r}") from err


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows.

    Parameters
    ----------
    path : Path
        JSON file; its folder is made if needed.
    rows : sequence of dict
        The rows.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    cli.write_json(path, list(rows))


def merged_rows(old: Sequence[Row], new: Sequence[Row]) -> list[Row]:
    """Put new rows in the place of old ones.

    A measurement that failed takes the place of what was measured before, which is kept as text. A row that
    could not be measured here, for want of its clip, replaces nothing. Rows of figures that are not defined
    any more go; figures that were never measured have a row that says so. All rows have today's words; one
    that was measured when something else was asked is of unknown code.

    Parameters
    ----------
    old, new : sequence of dict
        Rows.

    Returns
    -------
    list of dict
        One row per figure and clip, in the order of the document.
    """
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
    """Return the document that people read.

    Parameters
    ----------
    rows : sequence of dict
        All rows.
    now : mapping of tuple to str, optional
        Digests of the code that measures them; as it is now by default.

    Returns
    -------
    str
        Markdown.
    """
    found = digests() if now is None else now
    return page.text([page.Entry(row, found.get(row_key(row))) for row in rows])


def write_document(new: Sequence[Row]) -> None:
    """Enter new rows into both files of the document, and into the README.

    Parameters
    ----------
    new : sequence of dict
        The rows.
    """
    rows = merged_rows(read_rows(DOCUMENT), new)
    write_rows(DOCUMENT, rows)
    texts = {DOCUMENT.with_suffix(".md"): document_text(rows)}
    if README.exists():
        texts[README] = readme.with_measured(README.read_text(encoding="utf-8"), rows)
    for path, text in texts.items():
        with atomic_output(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
