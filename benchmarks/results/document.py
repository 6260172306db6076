"""The document of results, whether each is still that of the code, and the page made of them."""

import json
import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.results.canaries import canary
from benchmarks.results.code import ROOT, code_digest, own_code
from benchmarks.results.harness import Measured
from benchmarks.results.rows import ROWS, Row
from dvc.files import atomic_output

DOCUMENT, PAGE = ROOT / "docs" / "results.json", ROOT / "docs" / "results.md"
SCHEMA = "dvc3d-results/1"
Entry = dict[str, Any]
"""A result as the document has it."""
_HARNESS = "benchmarks.results.harness"
ABSENT = "not measured with this code"


def read_document(path: Path = DOCUMENT) -> dict[str, Entry]:
    """Return all results, by name."""
    if not path.exists():
        return {}
    return {entry["name"]: entry for entry in json.loads(path.read_text(encoding="utf-8"))["results"]}


def write_document(entries: dict[str, Entry], path: Path = DOCUMENT) -> None:
    """Write results in the order of their rows, without removed ones."""
    kept = [entries[row.name] for row in ROWS if row.name in entries]
    text = json.dumps({"schema": SCHEMA, "results": kept}, ensure_ascii=False, indent=1)
    with atomic_output(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def entry_of(row: Row, measured: Measured, wall_s: float) -> Entry:
    """Return the record of a result."""
    values = measured.by_clip.values()
    return {
        "name": row.name,
        "title": row.title,
        "target": row.target,
        "value": measured.value,
        "text": row.written(measured.value),
        "met": row.met(measured.value),
        "spread": [min(values), max(values)] if values else None,
        "by_clip": {clip: round(value, 4) for clip, value in measured.by_clip.items()},
        "frames": measured.frames,
        "note": measured.note,
        "command": f"python -m benchmarks.results --row {row.name}",
        "digest": code_digest(),
        "measured_with": code_digest(),
        "own_code": row_code(row),
        "canaries": {name: canary(name) for name in row.canaries},
        "machine": machine(),
        "date": datetime.now(UTC).date().isoformat(),
        "wall_s": round(wall_s, 1),
    }


def row_code(row: Row) -> str:
    """Digest the code of the measurement, and the files that it reads."""
    files = [path.read_bytes() for path in row.files if path.exists()]
    return own_code(row.module, _HARNESS, files=files)


def machine() -> str:
    """Name the processor."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, {len(os.sched_getaffinity(0))} cores"


def is_current(entry: Entry, row: Row) -> bool:
    """Return whether a result is that of the present code, without running anything."""
    return bool(entry["digest"] == code_digest() and _same_question(entry, row))


def still_holds(entry: Entry, row: Row) -> bool:
    """Return whether the present code would write the same bytes as the code of the result."""
    if not _same_question(entry, row) or entry["own_code"] != row_code(row):
        return False
    return all(entry["canaries"].get(name) == canary(name) for name in row.canaries)


def _same_question(entry: Entry, row: Row) -> bool:
    return bool(entry["title"] == row.title and entry["target"] == row.target)


def kept(entries: dict[str, Entry]) -> dict[str, Entry]:
    """Carry results over to the present code if canaries and own code are the same; drop the rest."""
    found = {}
    for row in ROWS:
        entry = entries.get(row.name)
        if entry is not None and (is_current(entry, row) or still_holds(entry, row)):
            found[row.name] = entry | {"digest": code_digest()}
    return found


def one_code(entries: dict[str, Entry]) -> dict[str, Entry]:
    """Return the results of the most frequent code: a page never mixes."""
    digests = [entry["digest"] for entry in entries.values()]
    most = max(sorted(set(digests)), key=digests.count) if digests else None
    return {name: entry for name, entry in entries.items() if entry["digest"] == most}


def page_text(entries: dict[str, Entry]) -> str:
    """Write the page: missed targets first, then those that are met, then results without target or value."""
    shown = one_code(entries)
    missed = [row for row in ROWS if row.name in shown and shown[row.name]["met"] is False]
    met = [row for row in ROWS if row.name in shown and shown[row.name]["met"]]
    free = [row for row in ROWS if row.name in shown and shown[row.name]["met"] is None]
    absent = [row for row in ROWS if row.name not in shown]
    parts = [_HEAD.format(count=len(ROWS)), _made_by(shown)]
    for title, rows in (("Target missed", missed), ("Target met", met), ("No target", free)):
        if rows:
            parts.append(f"\n## {title}\n\n{_table(rows, shown)}")
    if absent:
        lines = "\n".join(f"* `{row.name}`: {row.title} (target: {row.target})" for row in absent)
        parts.append(f"\n## {ABSENT[0].upper()}{ABSENT[1:]}\n\n{lines}\n")
    return "".join(parts)


_HEAD = """\
# Results

The {count} headline results, made by `make results`; nothing is typed in. All are of one code, or of earlier
code with canaries of the same bytes; `hostile/campaign` and `hostile/cuts` add up all runs of
`python -m benchmarks.hostile --hours 2` and `python -m benchmarks.hostile.cuts`.
Means over clips, least and largest clip in brackets. BD-rate: mean difference in rate at equal PSNR, negative
is less; `dvc-rd compare` prints the same for the folders of `results/headline`. Clips: box, desk, river,
stone, tree, cube (`../shared/sequences`) and the rendered scenes street, stairway, statue; CIF. Streams are
in colour except for results of luma only; PSNRs are of luma, or of colour as (6 Y + Cb + Cr) / 8. Rates are
sizes of files. [Anchors](anchors.md) run at constant QP on the same frames. A missed target
is work to do; a document with another number than the result, a false claim, makes a test fail.
`python -m benchmarks.results --check` lists the results that are those of the code.
"""


def _made_by(shown: dict[str, Entry]) -> str:
    if not shown:
        return ""
    first = next(iter(shown.values()))
    carried = sum(entry["digest"] != entry["measured_with"] for entry in shown.values())
    wall_min = sum(entry["wall_s"] for entry in shown.values()) / 60.0
    text = f"\nCode {first['digest']}; {first['machine']}; {wall_min:.0f} min.\n"
    if carried:
        text += f"{carried} of these were measured with earlier code, with canaries of the same bytes.\n"
    return text


def _table(rows: Sequence[Row], shown: dict[str, Entry]) -> str:
    lines = ["| result | value | target | clips, frames | |", "| --- | --- | --- | --- | --- |"]
    for row in rows:
        entry = shown[row.name]
        spread = entry["spread"]
        value = entry["text"]
        if spread and len(entry["by_clip"]) > 1:
            value += f" ({row.written(spread[0])} to {row.written(spread[1])})"
        clips = ", ".join(map(str, filter(None, [len(entry["by_clip"]) or None, entry["frames"]])))
        lines.append(f"| {row.title} | {value} | {row.target} | {clips} | `{row.name}` {entry['note']} |")
    return "\n".join(lines) + "\n"
