"""Chapters of the thesis: measure their steps, cache finished ones, and write their documents and pages."""

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.picture_files import write_png
from dvc.rd.originals import input_digest, values_digest
from dvc.versions import CODEC, library_versions, packages_digest
from dvc.web.drawing import Picture
from dvc.web.gallery import Gallery, Group, Shown, Table, markdown, write_gallery

STEPS_FOLDER = "steps"
SCHEMA = "dvc3d-thesis-step/2"
PAGE = "index.html"
MISSING = "–"
CHAPTERS = Path(__file__).with_name("chapters.toml")


class Method(StrEnum):
    """Methods that are measured."""

    THESIS = "thesis"
    """Method as the thesis writes it."""
    DEFAULT = "ours"
    """Method of the commands of this project."""


METHODS = tuple(Method)
TITLES = {Method.THESIS: "as written", Method.DEFAULT: "ours"}
"""Titles of their columns."""


@dataclass(frozen=True)
class Task:
    """Request to measure a chapter."""

    folder: Path  # folder of the results
    data: Path | None = None  # folder of the real sets
    chosen: tuple[str, ...] = ()  # sets, sequences, or files of the user; empty: those of the preset
    full: bool = False  # whether to take hours rather than minutes
    jobs: int = 1  # number of processor cores
    frames: int | None = None  # number of frames of each sequence, instead of the preset's
    cluster: str | None = None  # address of a Dask scheduler that measures sequences
    disparities: str | None = None  # range of the disparities of the user's views

    @property
    def user_files(self) -> bool:
        """Whether files of the user are measured."""
        return any(Path(name).is_file() for name in self.chosen)


class Value(NamedTuple):
    """A number, or a text instead of it."""

    source: str  # table, figure or section of the thesis, such as ``Table 2.1``
    label: str  # description with the unit
    value: float | str
    form: str = ".2f"

    @property
    def text(self) -> str:
        """The value as tables show it."""
        return self.value if isinstance(self.value, str) else format(self.value, self.form)


@dataclass
class StepResult:
    """Numbers, tables and pictures of a step."""

    values: list[Value] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)  # tables that the thesis does not have
    # by number and subject of the figure; plots are contents of files by suffix
    pictures: dict[tuple[str, str], Picture] = field(default_factory=dict)
    plots: dict[tuple[str, str], dict[str, bytes]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)  # reasons to repeat the step in the next run


class Step(NamedTuple):
    """A part of a chapter that is measured and cached by itself."""

    name: str  # part of the name of its file
    make: Callable[[Task, Method], StepResult]
    methods: tuple[Method, ...] = METHODS


@dataclass(frozen=True)
class CachedStep:
    """Result of a step, with the names of its pictures."""

    method: Method
    values: list[Value]
    tables: list[Table]
    files: list[tuple[str, str, str]]  # number and subject of a figure, name of its file


class Figure(NamedTuple):
    """A figure or table of the thesis."""

    number: str  # such as ``2.9``
    shows: str
    instead: str = ""  # why it is not drawn or shows other data, and its replacement


@dataclass(frozen=True)
class Chapter:
    """A chapter of the thesis."""

    number: int
    title: str
    printed: Mapping[tuple[str, str], str]  # values that the thesis prints, by source and label, in its order
    figures: Sequence[Figure]
    readings: Sequence[str]  # points that the text leaves open, with our reading
    steps: Callable[[Task], Sequence[Step]]


def load_chapter(number: int, steps: Callable[[Task], Sequence[Step]]) -> Chapter:
    """Read the printed values, figures and readings of a chapter."""
    data = tomllib.loads(CHAPTERS.read_text(encoding="utf-8"))[f"chapter{number}"]
    printed = {
        (source, label): text for source, rows in data["printed"].items() for label, text in rows.items()
    }
    figures = [Figure(*figure) for figure in data["figures"]]
    return Chapter(number, data["title"], printed, figures, tuple(data["readings"]), steps)


def planned(chapter: Chapter, task: Task, methods: Sequence[Method]) -> list[tuple[Step, Method]]:
    """List steps with the methods that they are measured by."""
    return [(step, method) for step in chapter.steps(task) for method in methods if method in step.methods]


def measure(
    chapter: Chapter, task: Task, methods: Sequence[Method], advance: Callable[[int], None] = lambda _: None
) -> list[str]:
    """Make all steps that are not cached, write document and page, and return the failures."""
    (task.folder / STEPS_FOLDER).mkdir(parents=True, exist_ok=True)
    inputs = [input_digest(Path(name)) for name in task.chosen if Path(name).exists()]
    code = packages_digest([*CODEC, "sequences", "benchmarks.thesis"])
    steps, failures = [], list[str]()
    for step, method in planned(chapter, task, methods):
        path = task.folder / STEPS_FOLDER / f"{step.name}-{method}.json"
        identity = _identity(step, task, code, inputs)
        cached = _read(path, identity)
        if cached is None:
            result = step.make(task, method)
            failures += result.failures
            cached = _write(path, identity, method, result)
        steps.append(cached)
        advance(1)
    _write_chapter(task.folder, chapter, methods, steps)
    return failures


def _identity(step: Step, task: Task, code: str, inputs: Sequence[str]) -> str:
    """Digest everything that a result depends on: request, input files, code and libraries."""
    make = getattr(step.make, "func", step.make)
    name = f"{make.__module__}.{make.__qualname__}"
    request = [str(task.data), task.chosen, task.full, task.frames, task.disparities, *inputs]
    return values_digest([SCHEMA, name, request, code, library_versions()])


def _read(path: Path, identity: str) -> CachedStep | None:
    """Read a cached step, unless it has another identity or lacks a file."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        tables = [
            replace(Table(**table), head=tuple(table["head"]), rows=tuple(map(tuple, table["rows"])))
            for table in data["tables"]
        ]
        values = [Value(*value) for value in data["values"]]
        files = [(number, subject, name) for number, subject, name in data["files"]]
        cached = CachedStep(Method(data["method"]), values, tables, files)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    is_complete = all((path.parents[1] / name).is_file() for *_, name in files)
    return cached if data.get("identity") == identity and is_complete else None


def _write(path: Path, identity: str, method: Method, result: StepResult) -> CachedStep:
    """Write the files of a step, then its record unless a part of it has failed."""
    folder = path.parents[1]
    for key, picture in result.pictures.items():
        write_png(folder / file_name(*key, method), picture)
    for key, contents in result.plots.items():
        for suffix, content in contents.items():
            plot = (folder / file_name(*key, method)).with_suffix(suffix)
            with atomic_output(plot) as temporary:
                temporary.write_bytes(content)
    files = [(*key, file_name(*key, method)) for key in (*result.pictures, *result.plots)]
    cached = CachedStep(method, result.values, result.tables, files)
    if not result.failures:
        record = {"identity": identity, **vars(cached), "tables": [vars(table) for table in result.tables]}
        cli.write_json(path, record)
    return cached


def file_name(number: str, subject: str, method: Method) -> str:
    """Return the name of the picture of a figure."""
    plain = "".join(letter if letter.isalnum() else "-" for letter in subject.lower())
    return "-".join(part for part in ("figure", number, plain, method) if part) + ".png"


def _write_chapter(
    folder: Path, chapter: Chapter, methods: Sequence[Method], steps: Sequence[CachedStep]
) -> None:
    """Write the document, the page and the numbers of a chapter."""
    title = f"Chapter {chapter.number}: {chapter.title}"
    tables = [*_value_tables(chapter, methods, steps), _figure_table(chapter, steps)]
    for step in steps:
        tables += [replace(one, title=f"{one.title} ({TITLES[step.method]})") for one in step.tables]
    files = sorted(
        ((number, subject, step.method, name) for step in steps for number, subject, name in step.files),
        key=lambda file: (int(_without_part(file[0]).partition(".")[2]), file[0]),
    )
    text = [f"# {title}\n", *map(markdown, tables), "What the text leaves open:\n"]
    text += [*(f"- {reading}" for reading in chapter.readings), ""]
    groups: dict[str, list[Shown]] = {}
    for number, subject, method, name in files:
        figure = f"{number}" + (f", {subject}" if subject else "")
        text.append(f"![figure {figure}, {TITLES[method]}]({name})\n")
        groups.setdefault(f"Figure {figure}", []).append(Shown(TITLES[method], _picture(folder / name)))
    with atomic_output(folder / f"chapter{chapter.number}.md") as temporary:
        temporary.write_text("\n".join(text), encoding="utf-8")
    numbers = [
        {
            "source": value.source,
            "label": value.label,
            "printed": chapter.printed.get((value.source, value.label)),
            "method": str(step.method),
            "value": value.value,
        }
        for step in steps
        for value in step.values
    ]
    cli.write_json(folder / f"chapter{chapter.number}.json", numbers)
    preface = "Each number as it is printed, by its method as it is written, and by ours."
    named = [Group(name, tuple(shown)) for name, shown in groups.items()]
    write_gallery(folder / PAGE, Gallery(title, preface, named, tables, tuple(chapter.readings)))


def _value_tables(chapter: Chapter, methods: Sequence[Method], steps: Sequence[CachedStep]) -> list[Table]:
    """Return a table of printed and measured values for each table, figure or section of the thesis."""
    texts = {(value.source, value.label, step.method): value.text for step in steps for value in step.values}
    rows: dict[str, list[tuple[str, ...]]] = {}
    for source, label in dict.fromkeys([*chapter.printed, *(key[:2] for key in texts)]):
        measured = [texts.get((source, label, method), MISSING) for method in methods]
        row = (label, chapter.printed.get((source, label), MISSING), *measured)
        rows.setdefault(source, []).append(row)
    head = ("", "printed in the thesis", *(TITLES[method] for method in methods))
    return [Table(source, "Printed, and measured", head, tuple(rows[source])) for source in rows]


def _figure_table(chapter: Chapter, steps: Sequence[CachedStep]) -> Table:
    """List the figures of the chapter: which of them are drawn, and replacements of those that are not."""
    drawn = {_without_part(number) for step in steps for number, *_ in step.files}
    rows = []
    for number, shows, instead in chapter.figures:
        status = "drawn" if number in drawn else "not drawn"
        rows.append((number, shows, f"{status}: {instead}" if instead else status))
    return Table("Figures", "Figures of the chapter", ("figure", "shows", "here"), tuple(rows), 3)


def _without_part(number: str) -> str:
    """Return the number of a figure without the letter of a part of it."""
    return number.rstrip("abcdefgh")


def _picture(path: Path) -> Picture:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise DvcError(f"{path} is not a readable picture")
    return np.asarray(picture, np.uint8)
