"""Draw rate against cost, and fill in the tables of `docs/encoder_cost.md`, from the rows of the figures."""

import argparse
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.figures.allocation.curves import AREA as ALLOCATION
from benchmarks.figures.allocation.curves import TRACKED
from benchmarks.figures.cost.rate_cost import AREA, REFERENCE, label
from benchmarks.figures.document import DOCUMENT, read_rows
from benchmarks.figures.harness import STATIC_CLIPS, Row
from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.plots import Style, label_styles
from dvc.rd.rate_cost import RateCost, rate_cost_cells, render_rate_cost
from dvc.rd.tables import table

PROG = "python -m benchmarks.pictures.cost"
EXAMPLES = """\
  python -m benchmarks.pictures.cost     docs/cost/rate-against-cost.*, tables of docs/encoder_cost.md
"""
FOLDER = Path("docs") / "cost"
PAGE = Path("docs") / "encoder_cost.md"
GROUPS = ("rate-cost", "rate-cost-standard")
"""Figures of rate against cost, those with the most codecs first."""
KINDS = ("adds", "multiplies", "logic", "compares", "bytes")
Found = Mapping[str, Mapping[str, float]]


def measured(rows: Sequence[Row], name: str) -> dict[str, Row]:
    """Return the rows of a figure that were measured."""
    found = {row["clip"]: row for row in rows if (row["area"], row["name"]) == (AREA, name) and row["values"]}
    return {clip: found[clip] for clip in STATIC_CLIPS if clip in found}


def rate_costs(rows: Sequence[Row]) -> tuple[list[RateCost], list[str]]:
    """Average rate and cost of all codecs over the clips on which most of them were measured."""
    name = next((name for name in GROUPS if measured(rows, name)), None)
    if name is None:
        raise DvcError(f"{DOCUMENT}: no row of rate against cost was measured")
    found: dict[str, Found] = {
        clip: row["values"]["codecs"] | _with_feedback(rows, clip, row["values"]["codecs"])
        for clip, row in measured(rows, name).items()
    }
    common = [codec for codec in next(iter(found.values())) if all(codec in of for of in found.values())]
    points = [
        RateCost(
            label(codec),
            statistics.fmean(found[clip][codec]["cost_ms"] for clip in found),
            statistics.fmean(found[clip][codec]["bd_rate_percent"] for clip in found),
            len(found),
        )
        for codec in common
    ]
    return sorted(points, key=lambda point: point.cost_ms), list(found)


def _with_feedback(rows: Sequence[Row], clip: str, codecs: Found) -> Found:
    """Return rate and cost of tracked coding live, from the rows that tell them, where there are such rows.
    Return rate and cost of tracked coding live, from the rows that tell them, where there are such rows.
    """
    values = {
        (row["area"], row["name"]): row["values"] for row in rows if row["clip"] == clip and row["values"]
    }
    rate, time = (values.get(name) for name in ((ALLOCATION, "te-qp-x264-ippp"), (AREA, "live-cpu")))
    if rate is None or time is None or "x264-superfast" not in codecs:
        return {}
    cost_ms = time["ratios"]["x264-superfast"] * codecs["x264-superfast"]["cost_ms"]
    return {TRACKED: {"cost_ms": cost_ms, "bd_rate_percent": rate["bd_rate_percent"]}}


def styles(points: Sequence[RateCost]) -> dict[str, Style]:
    """Give every codec its style: those of the project filled."""
    anchors = {codec.label for codec in ANCHOR_CODECS.values()}
    labels = [point.label for point in points]
    own = [label for label in labels if label not in anchors]
    return label_styles(own, [label for label in labels if label in anchors])


def operations_table(rows: Sequence[Row]) -> str:
    """Return the table of operations, means over the clips on which they were counted."""
    found = [row["values"]["operations_per_pixel"] for row in measured(rows, "operations").values()]
    if not found:
        return "not counted\n"
    lines = []
    for stage in found[0]:
        numbers = [statistics.fmean(one[stage][kind] for one in found) for kind in KINDS]
        lines.append([stage, *(f"{number:.2f}" for number in numbers)])
    totals = [sum(float(line[1 + k]) for line in lines) for k in range(len(KINDS))]
    lines.append(["all", *(f"{total:.1f}" for total in totals)])
    return table(["stage", *KINDS], lines)


def with_part(page: str, name: str, text: str) -> str:
    """Put text into a page, between the marks of that name."""
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    before, found, rest = page.partition(begin)
    if not found or end not in rest:
        raise DvcError(f"{PAGE}: no marks of the part {name!r}")
    return f"{before}{begin}{text}{end}{rest.partition(end)[2]}"


def _draw(_: argparse.Namespace) -> int:
    rows = read_rows(DOCUMENT)
    points, clips = rate_costs(rows)
    reference = ANCHOR_CODECS[REFERENCE].label
    FOLDER.mkdir(parents=True, exist_ok=True)
    for suffix, data in render_rate_cost(points, styles(points), reference).items():
        with atomic_output(FOLDER / f"rate-against-cost{suffix}") as temporary:
            temporary.write_bytes(data)
    page = PAGE.read_text(encoding="utf-8")
    head, cells = rate_cost_cells(points, reference)
    where = f"\nMeans over {', '.join(clips)}.\n"
    page = with_part(page, "rate against cost", table(head, cells) + where)
    page = with_part(page, "operations", operations_table(rows))
    with atomic_output(PAGE) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return 0


def _parser() -> argparse.ArgumentParser:
    return cli.ArgumentParser(PROG, "Draw rate against cost, and fill in the tables of its page.", EXAMPLES)


main = cli.command(PROG, _parser, _draw)

if __name__ == "__main__":
    sys.exit(main())
