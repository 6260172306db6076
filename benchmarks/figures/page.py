"""The document that people read: what is claimed, with the clips behind it, then all rows."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.figures.claims import CLAIMS, Claim, Name
from benchmarks.figures.harness import FOREMAN, SCENES, STATIC_CLIPS, Row

FAILS, UNKNOWN, STANDS = "fails", "cannot be told", "stands"
"""Verdicts of claims, in the order of the document."""
_MEANING = {
    FAILS: "A row behind it does not hold, or its measurement failed.",
    UNKNOWN: "No row fails, but some were not measured, or the code has moved since.",
    STANDS: "Every row behind it was measured with the code as it is, and holds.",
}
_ALL_CLIPS = "all"
_CLIPS = (*STATIC_CLIPS, "cube", *SCENES, FOREMAN, _ALL_CLIPS)
_INTRODUCTION = (
    "What is claimed and asked of the project, and what was measured. Made by `make figures` from "
    "`figures.json`; no number is typed in by hand. A figure *holds* or not; nothing stands there where only "
    "the true figure is asked for. It is **stale** if the code that measures it has changed since, or if it "
    "is not known which code that was: its verdict is that of the older code. A measurement that **failed** "
    "counts as one that does not hold. `python -m benchmarks.figures --page` looks again which are stale."
)


@dataclass(frozen=True)
class Entry:
    """A row, and the code that would measure it now."""

    row: Row  # row of the document
    digest: str | None  # of the code as it is; None if the figure is not defined

    @property
    def is_measured(self) -> bool:
        """Whether there is a figure."""
        return self.row["got"] is not None

    @property
    def is_stale(self) -> bool:
        """Whether other code than today's has measured it."""
        return self.row["date"] is not None and self.row["code"] != self.digest

    @property
    def verdict(self) -> str:
        """Whether it holds, in words."""
        if not self.is_measured:
            return "**failed**" if self.row["holds"] is False else ""
        verdict = {True: "yes", False: "**no**", None: ""}[self.row["holds"]]
        if not self.is_stale:
            return verdict
        return f"stale: {verdict}" if verdict else "stale"

    @property
    def short(self) -> str:
        """What was measured without its details."""
        if not self.is_measured:
            return ""
        return short(self.row["got"])


def short(got: str) -> str:
    """Return what was measured without its details."""
    for end in (" (", "; ", ", ", " over "):
        got = got.split(end, maxsplit=1)[0]
    return got


def claim_verdict(entries: Sequence[Entry]) -> str:
    """Judge a claim by the rows behind it."""
    if any(entry.row["holds"] is False for entry in entries):
        return FAILS
    fresh = all(entry.is_measured and not entry.is_stale for entry in entries)
    return STANDS if fresh and entries else UNKNOWN


def text(entries: Sequence[Entry]) -> str:
    """Write the document."""
    rows: dict[Name, list[Entry]] = {}
    for entry in entries:
        rows.setdefault((entry.row["area"], entry.row["name"]), []).append(entry)
    claims = [(claim, [entry for name in claim.rows for entry in rows.get(name, [])]) for claim in CLAIMS]
    lines = ["# Figures\n", f"{_INTRODUCTION}\n", f"{_counts(entries)}\n", "## Claims\n"]
    judged = [(claim_verdict(behind), claim, behind) for claim, behind in claims if behind]
    for verdict, meaning in _MEANING.items():
        chosen = [(claim, behind) for found, claim, behind in judged if found == verdict]
        if chosen:
            lines.append(f"### {verdict.capitalize()}: {len(chosen)} of {len(judged)}\n\n{meaning}\n")
        lines += [_claim(claim, behind) for claim, behind in chosen]
    for area in dict.fromkeys(entry.row["area"] for entry in entries):
        members = [entry for entry in entries if entry.row["area"] == area]
        lines += [f"## {area}\n", _table(members, any(entry.row["thesis"] for entry in members))]
    return "\n".join(lines)


def _counts(entries: Sequence[Entry]) -> str:
    """Say how many rows there are of each kind, and on what machines they were measured."""
    kinds = {
        "do not hold": sum(entry.is_measured and entry.row["holds"] is False for entry in entries),
        "failed": sum(not entry.is_measured and entry.row["holds"] is False for entry in entries),
        "are not measured yet": sum(entry.row["date"] is None for entry in entries),
        "are stale": sum(entry.is_stale for entry in entries),
        "of these of unknown code": sum(entry.is_stale and not entry.row["code"] for entry in entries),
    }
    machines = Counter(entry.row["machine"] or "not known" for entry in entries if entry.row["date"])
    told = "; ".join(f"{name}: {count}" for name, count in sorted(machines.items()))
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    return f"Of {len(entries)} rows {counts}. Kinds of machine, and rows: {told or 'none'}."


def _claim(claim: Claim, entries: Sequence[Entry]) -> str:
    """Write a claim and its matrix: a line for each figure, a column for each clip."""
    clips = sorted({entry.row["clip"] or _ALL_CLIPS for entry in entries}, key=_CLIPS.index)
    lines = [["row", "asked", *clips], ["---"] * (2 + len(clips))]
    for area, name in claim.rows:
        cells = {entry.row["clip"] or _ALL_CLIPS: entry for entry in entries if _is_of(entry, area, name)}
        if cells:
            asked = next(iter(cells.values())).row["asked"]
            values = [_cell(cells[clip]) if clip in cells else "" for clip in clips]
            lines.append([f"{area}/{name}", asked, *values])
    return f"**{claim.says}** ({', '.join(claim.where)})\n\n{_markdown(lines)}"


def _is_of(entry: Entry, area: str, name: str) -> bool:
    return (entry.row["area"], entry.row["name"]) == (area, name)


def _cell(entry: Entry) -> str:
    value = entry.short or ("" if entry.verdict else "not measured")
    return f"{value}, {entry.verdict}" if value and entry.verdict else value or entry.verdict


def _table(entries: Sequence[Entry], with_thesis: bool) -> str:
    head = ["figure", "clip", "asked", *(["thesis"] if with_thesis else []), "measured", "holds", "date"]
    lines = [head, ["---"] * len(head)]
    for entry in entries:
        row = entry.row
        thesis = [row["thesis"] or ""] if with_thesis else []
        cells = [row["title"], row["clip"] or "", row["asked"], *thesis, _measured(row), entry.verdict]
        lines.append([*cells, row["date"] or ""])
    return _markdown(lines)


def _measured(row: Row) -> str:
    if row["got"] is not None:
        return f"{row['got']} ({row['note']})" if row["note"] else str(row["got"])
    before = f"; before: {row['before']}" if row["before"] else ""
    return f"*{row['note']}{before}*"


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)
