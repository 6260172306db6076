"""Pages of a chapter: its numbers in three columns, its figures, and what stands in their place."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.thesis.chapter import Chapter, Value, Way
from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.web.drawing import Picture
from dvc.web.gallery import Gallery, Group, Shown, Table, markdown, write_gallery

PAGE = "index.html"
NOTHING = "–"
TITLES = {Way.THESIS: "as written", Way.OURS: "ours"}


@dataclass(frozen=True)
class Kept:
    """What is kept of a step."""

    way: Way  # whose method it was
    values: list[Value]  # what it has found
    tables: list[Table]
    files: dict[tuple[str, str], str]  # names of pictures, by the number of their figure and what they are of


def write_chapter(folder: Path, chapter: Chapter, ways: Sequence[Way], kept: Sequence[Kept]) -> None:
    """Write the document, the page and the numbers of a chapter."""
    title = f"Chapter {chapter.number}: {chapter.title}"
    tables = [*value_tables(chapter, ways, kept), figure_table(chapter, kept)]
    tables += [table for one in kept for table in _titled(one)]
    pictures = [(number, of, name, one.way) for one in kept for (number, of), name in one.files.items()]
    pictures.sort(key=lambda picture: _order(picture[0]))
    open_points = ["What the text leaves open:\n", *(f"- {reading}" for reading in chapter.readings), ""]
    drawn = [f"![{_caption(number, of, way)}]({name})\n" for number, of, name, way in pictures]
    text = "\n".join([f"# {title}\n", *map(markdown, tables), *open_points, *drawn])
    with atomic_output(folder / f"chapter{chapter.number}.md") as temporary:
        temporary.write_text(text, encoding="utf-8")
    cli.write_json(folder / f"chapter{chapter.number}.json", _numbers(chapter, kept))
    groups: dict[str, list[Shown]] = {}
    for number, of, name, way in pictures:
        group = f"Figure {number}" + (f", {of}" if of else "")
        groups.setdefault(group, []).append(Shown(TITLES[way], _read(folder / name)))
    preface = "Each number as it is printed, by its method as it is written, and by ours."
    named = [Group(name, tuple(shown)) for name, shown in groups.items()]
    write_gallery(folder / PAGE, Gallery(title, preface, named, tables, tuple(chapter.readings)))


def value_tables(chapter: Chapter, ways: Sequence[Way], kept: Sequence[Kept]) -> list[Table]:
    """Put what is printed and what was found side by side, a table for each place."""
    found = {(value.place, value.what, one.way): value.text for one in kept for value in one.values}
    names = dict.fromkeys([*chapter.printed, *(key[:2] for key in found)])
    head = ("", "printed in the thesis", *(TITLES[way] for way in ways))
    tables = []
    for place in dict.fromkeys(place for place, _ in names):
        rows = [
            (
                what,
                chapter.printed.get((place, what), NOTHING),
                *(found.get((place, what, way), NOTHING) for way in ways),
            )
            for other, what in names
            if other == place
        ]
        tables.append(Table(place, "Printed, and measured", head, tuple(rows)))
    return tables


def figure_table(chapter: Chapter, kept: Sequence[Kept]) -> Table:
    """List the figures of the chapter: which are drawn, and what stands in the place of others."""
    drawn = {number for one in kept for number, _ in one.files}
    rows = []
    for figure in chapter.figures:
        here = "drawn" if any(_whole(name) == figure.number for name in drawn) else "not drawn"
        rows.append((figure.number, figure.shows, f"{here}: {figure.instead}" if figure.instead else here))
    return Table("Figures", "Figures of the chapter", ("figure", "shows", "here"), tuple(rows), 3)


def _titled(one: Kept) -> list[Table]:
    return [
        Table(f"{table.title} ({TITLES[one.way]})", table.caption, table.head, table.rows, table.num_names)
        for table in one.tables
    ]


def _numbers(chapter: Chapter, kept: Sequence[Kept]) -> list[dict[str, Any]]:
    """Return all values as JSON has them, one after the other."""
    return [
        {
            "place": value.place,
            "what": value.what,
            "printed": chapter.printed.get((value.place, value.what)),
            "way": str(one.way),
            "value": value.value,
        }
        for one in kept
        for value in one.values
    ]


def _whole(number: str) -> str:
    """Return the number of a figure without the letter of a part of it."""
    return number.rstrip("abcdefgh")


def _order(number: str) -> tuple[int, str]:
    return int(_whole(number).split(".")[1]), number


def _caption(number: str, of: str, way: Way) -> str:
    return ", ".join(part for part in (f"figure {number}", of, TITLES[way]) if part)


def _read(path: Path) -> Picture:
    found = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if found is None:
        raise DvcError(f"{path}: no picture")
    return np.asarray(found, np.uint8)
