"""Measures chapters step by step, keeps what is done, and goes on there when it is started again."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.thesis.chapter import Chapter, Made, Step, Task, Value, Way
from benchmarks.thesis.pages import Kept, write_chapter
from dvc import cli
from dvc.files import atomic_output
from dvc.picture_files import write_png
from dvc.rd.provenance import input_digest, values_digest
from dvc.source_digest import Sources
from dvc.versions import library_versions
from dvc.web.gallery import Table

STEPS_FOLDER = "steps"
SCHEMA = "dvc3d-thesis-step/1"


def measure(
    chapter: Chapter, task: Task, ways: Sequence[Way], advance: Callable[[int], None] = lambda _: None
) -> list[str]:
    """Make all steps that are not there yet, write the pages, and return what could not be measured."""
    (task.folder / STEPS_FOLDER).mkdir(parents=True, exist_ok=True)
    sources, inputs = Sources(), [input_digest(Path(name)) for name in task.chosen if Path(name).exists()]
    kept, failures = [], []
    for step, way in planned(chapter, task, ways):
        identity = _identity(step, task, sources, inputs)
        path = task.folder / STEPS_FOLDER / f"{step.name}-{way}.json"
        found = _read(path, identity)
        if found is None:
            made = step.make(task, way)
            failures += made.failures
            found = _written(path, identity, way, made)
        kept.append(found)
        advance(1)
    write_chapter(task.folder, chapter, ways, kept)
    return failures


def planned(chapter: Chapter, task: Task, ways: Sequence[Way]) -> list[tuple[Step, Way]]:
    """List steps with the ways that they are measured in."""
    return [(step, way) for step in chapter.steps(task) for way in ways if way in step.ways]


def _identity(step: Step, task: Task, sources: Sources, inputs: Sequence[str]) -> str:
    """Digest what the results of a step follow from: what is asked for, its files, code, and libraries."""
    make = getattr(step.make, "func", step.make)
    code = sources.digest([(make.__module__, make.__qualname__)])
    asked = [str(task.data), task.chosen, task.full, task.frames, task.disparities, *inputs]
    return values_digest([SCHEMA, asked, code, library_versions()])


def _read(path: Path, identity: str) -> Kept | None:
    """Read a step, if it was made by the same code for the same task, and all its files are there."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        kept = Kept(
            Way(data["way"]),
            [Value(*value) for value in data["values"]],
            [_table(table) for table in data["tables"]],
            {(number, of): name for number, of, name in data["files"]},
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
    there = all((path.parents[1] / name).is_file() for name in kept.files.values())
    return kept if data.get("made_by") == identity and there else None


def _table(data: dict[str, Any]) -> Table:
    rows = tuple(tuple(row) for row in data["rows"])
    return Table(data["title"], data["caption"], tuple(data["head"]), rows, data["num_names"])


def _written(path: Path, identity: str, way: Way, made: Made) -> Kept:
    """Write the files of a step, then what it has found, unless something of it has failed."""
    folder, files = path.parents[1], {}
    for (number, of), picture in made.pictures.items():
        files[number, of] = file_name(number, of, way)
        write_png(folder / files[number, of], picture)
    for (number, of), contents in made.plots.items():
        files[number, of] = file_name(number, of, way)
        for suffix, content in contents.items():
            with atomic_output(folder / Path(files[number, of]).with_suffix(suffix)) as temporary:
                temporary.write_bytes(content)
    kept = Kept(way, made.values, made.tables, files)
    if not made.failures:
        values = {
            "made_by": identity,
            "way": str(way),
            "values": [list(value) for value in kept.values],
            "tables": [vars(table) for table in kept.tables],
            "files": [[number, of, name] for (number, of), name in files.items()],
        }
        cli.write_json(path, values)
    return kept


def file_name(number: str, of: str, way: Way) -> str:
    """Return the name of the picture of a figure."""
    plain = "".join(letter if letter.isalnum() else "-" for letter in of.lower())
    return "-".join(part for part in ("figure", number, plain, way) if part) + ".png"
