"""The tables of the pages of results say what the figures say."""

import json
import re
from pathlib import Path
from statistics import fmean

import pytest

from benchmarks.figures.readme import section, with_measured
from dvc.errors import DvcError

DOCS = Path(__file__).parents[3] / "docs"
README = (DOCS.parent / "README.md").read_text(encoding="utf-8")
ROWS = {
    "H.264 intra": ("allocation", "te-qp-intra"),
    "H.264 IPPP, no motion": ("allocation", "te-qp-zero-motion"),
    "2D-DVC (`--codec 2d`), the same allocation": ("allocation", "te-qp-2d"),
    "TE with presets (`--wz-q`)": ("allocation", "te-qp-presets"),
    "H.264 IPPP, motion search, an intra frame every 16": ("allocation", "te-qp-x264-ippp-16"),
    "H.264 IPPP, motion search, one intra frame": ("allocation", "te-qp-x264-ippp"),
}
"""Area and name of the figures, by the first cell of the row."""


def test_table_has_the_figures() -> None:
    """Every BD-rate of the table is that of its figure, rounded to a per cent."""
    figures = json.loads((DOCS / "figures.json").read_text(encoding="utf-8"))
    found = {(row["area"], row["name"], row["clip"]): row["values"] for row in figures}
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    head, _, *rows = re.findall(
        r"^\| .* \|$", text.split("## Where it wins")[1].split("\n* ")[0], re.MULTILINE
    )
    clips = [cell.strip() for cell in head.strip("| ").split("|")][1:]
    assert len(rows) == len(ROWS)
    for row in rows:
        title, *cells = (cell.strip() for cell in row.strip("| ").split("|"))
        for clip, cell in zip(clips, cells, strict=True):
            area, name = ROWS[title]
            if clip == "mean":
                values = found[area, f"{name}-mean", None]
                value = fmean(values[one] for one in clips if one != "mean")
            else:
                value = found[area, name, clip]["bd_rate_percent"]
            assert cell == f"{value:+.0f} %".replace("-", "\N{MINUS SIGN}")


def test_readme_claims_what_rows_show() -> None:
    """Every number of the section of results is that of the row beside it."""
    figures = json.loads((DOCS / "figures.json").read_text(encoding="utf-8"))
    assert with_measured(README, figures) == README, "run python -m benchmarks.figures --page"
    table = [line for line in section(README).splitlines() if line.startswith("| ")][1:]
    assert len(table) > 4
    assert all(re.search(r" \| [^|]*\d[^|]* \| [\w -]+/[\w.-]+ \|$", line) for line in table[1:])
    words = "\n".join(line for line in section(README).splitlines() if not line.startswith("|"))
    assert not re.search(r"\d", words)


def test_readme_follows_its_rows() -> None:
    """A number goes where its row is named; one of a row that is not there is refused."""
    text = "# A\n\n## Results\n\n| rate |  | rd/mean |\n\n## B\n\n| rate |  | rd/mean |\n"
    row = {"area": "rd", "name": "mean", "clip": None, "got": "-3.1 % over 2 clips (a -3, b -3.2)"}
    found = with_measured(text, [row])
    assert found == text.replace("|  |", "| \N{MINUS SIGN}3.1 % |", 1)
    assert with_measured(found, [row | {"got": None}]).count("not measured") == 1
    with pytest.raises(DvcError, match="rd/mean"):
        with_measured(text, [row | {"clip": "a"}])


def test_page_of_depth_maps_has_the_figures() -> None:
    """Every row of its table says what the figure of its name says, and none is left out."""
    figures = json.loads((DOCS / "figures.json").read_text(encoding="utf-8"))
    wanted = {
        (row["name"], row["clip"] or ""): row["got"]
        for row in figures
        if row["area"] == "shape-adaptive" and row["got"] is not None
    }
    text = (DOCS / "shape-adaptive-results.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z-]+)`(?: \((\w+)\))? \| (.*) \|$", text, re.MULTILINE)
    assert {(name, clip): got for name, clip, got in rows} == wanted
