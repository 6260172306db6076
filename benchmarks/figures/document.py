"""Rows of figures in a file, what replaces what, and the document that people read."""

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figures.definitions import all_units
from benchmarks.figures.harness import Key, Row
from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output

DOCUMENT = Path("docs") / "figures.json"


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
        return [row for row in rows if row_key(row)]
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

    A row that could not be measured now does not replace what was measured before. Rows of figures that are
    not defined any more go; figures that were never measured have a row that says so, in today's words.

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
        if row["got"] is not None or known is None or known["got"] is None:
            rows[row_key(row)] = row
    merged = []
    for unit in all_units():
        row = rows.get(unit.key, {"got": None, "note": "not measured yet"})
        merged.append(unit.figure.row(unit.clip, None, row["note"]) if row["got"] is None else row)
    return merged


def document_text(rows: Sequence[Row]) -> str:
    """Return the document that people read.

    Parameters
    ----------
    rows : sequence of dict
        All rows.

    Returns
    -------
    str
        Markdown.
    """
    lines = [
        "# Figures\n",
        "What is asked of the project, and what was measured. Made by `make figures` from `figures.json`; "
        "no number is typed in by hand. *Holds* is empty where only the true figure is asked for.\n",
    ]
    for area in dict.fromkeys(row["area"] for row in rows):
        chosen = [row for row in rows if row["area"] == area]
        lines += [f"## {area}\n", _table(chosen, any(row["thesis"] for row in chosen))]
    return "\n".join(lines)


def _table(rows: Sequence[Row], with_thesis: bool) -> str:
    head = ["figure", "clip", "asked", *(["thesis"] if with_thesis else []), "measured", "holds", "date"]
    lines = [head, ["---"] * len(head)]
    for row in rows:
        note = f" ({row['note']})" if row["note"] and row["got"] is not None else ""
        measured = f"{row['got']}{note}" if row["got"] is not None else f"*{row['note']}*"
        holds = {True: "yes", False: "**no**", None: ""}[row["holds"]]
        thesis = [row["thesis"] or ""] if with_thesis else []
        lines.append(
            [row["title"], row["clip"] or "", row["asked"], *thesis, measured, holds, row["date"] or ""]
        )
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def write_document(new: Sequence[Row]) -> None:
    """Enter new rows into both files of the document.

    Parameters
    ----------
    new : sequence of dict
        The rows.
    """
    rows = merged_rows(read_rows(DOCUMENT), new)
    write_rows(DOCUMENT, rows)
    with atomic_output(DOCUMENT.with_suffix(".md")) as temporary:
        temporary.write_text(document_text(rows), encoding="utf-8")
