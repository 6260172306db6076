"""Chapters of the thesis: terms with their modules, from the glossary, and figures."""

import importlib
import re

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sources import DOCS
from sphinx.application import Sphinx

THESIS = "[Maitre2008]"
_TERM = re.compile(r"^\* \*\*(.+?)\*\*: (.*) \((`.+`)\)(.*)$", re.MULTILINE)
_PLACE = re.compile(r"(?<![\d.])(\d)\.(\d+)(?:\.(\d+))?")


def terms(chapter: int) -> list[tuple[str, str, str, str]]:
    """Return place, term, meaning and modules of the entries of a chapter in the glossary."""
    rows = []
    for term, meaning, module, sources in _TERM.findall((DOCS / "glossary.md").read_text(encoding="utf-8")):
        place = sources.partition(THESIS)[2].strip()
        found = [(int(a), int(b), int(c or 0)) for a, b, c in _PLACE.findall(place)]
        if found and found[0][0] == chapter:
            rows.append(("Eq" in place[:2], found[0], (place, term, meaning, module)))
    return [row for _, _, row in sorted(rows)]


def chapter_text(number: int) -> str:
    """Write the tables of a chapter."""
    chapter = importlib.import_module(f"benchmarks.thesis.chapter{number}").CHAPTER
    lines = ["| place | term | meaning | module |", "| --- | --- | --- | --- |"]
    lines += ["| " + " | ".join(row) + " |" for row in terms(number)]
    lines += ["", f"## Figures of `python -m benchmarks.thesis --chapter {number}`", ""]
    lines += ["| figure | shows | instead |", "| --- | --- | --- |"]
    lines += [f"| {one.number} | {one.shows} | {one.instead} |" for one in chapter.figures]
    lines += ["", "## What the text leaves open, and how it is read", ""]
    return "\n".join([*lines, *(f"* {reading}" for reading in chapter.readings), ""])


class ChapterTables(Directive):
    """Tables of a chapter."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Write the tables."""
        node = nodes.section()
        lines = chapter_text(int(self.arguments[0])).splitlines()
        self.state.nested_parse(StringList(lines, "chapter"), 0, node, match_titles=True)
        return node.children


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("chapter", ChapterTables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
