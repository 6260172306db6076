"""Reproduction of the thesis: the sweeps of its chapters, and one document with all tables and figures."""

from collections.abc import Sequence
from pathlib import Path

from dvc.errors import ConfigError, DvcError
from dvc.files import atomic_output
from dvc.rd.point_result import PointResult
from dvc.rd.points import Point
from dvc.rd.processes import ProcessGroup
from dvc.rd.provenance import values_digest
from dvc.rd.sources import available_clips, source_name
from dvc.rd.specification import expand
from dvc.rd.tables import measured_text, table
from dvc.rd.thesis.chapter import Chapter, Preset
from dvc.rd.thesis.chapter5 import CHAPTER_5

DOCUMENT = "thesis.md"
REPORT = "report.md"
PAGE = "report.html"


_H264 = ("intra", "x264-ippp-zero", "x264-ippp")
PRESETS = {
    "quick": Preset(9, (1, 4, 7), _H264, (20, 28, 36, 44), ("street",), ("box",)),
    "full": Preset(
        17,
        (1, 2, 4, 6, 8),
        (*_H264, "x265", "svtav1"),
        tuple(range(20, 45, 4)),
        ("street", "stairway", "statue"),
        ("box", "desk", "river", "stone", "tree"),
    ),
}
"""Presets by the names of the command line.

The thesis has 50 frames of each sequence; `full` has the 17 that the longest group of pictures spans, which
takes hours already.
"""


def chapters() -> tuple[Chapter, ...]:
    """List the chapters that can be reproduced."""
    return (CHAPTER_5,)


def preset_sequences(preset: Preset, processes: ProcessGroup) -> tuple[str, ...]:
    """List the sequences of a preset that are there."""
    available = available_clips(processes)
    return (*preset.scenes, *(name for name in preset.clips if name in available))


def plan(preset: Preset, sequences: Sequence[str]) -> list[Point]:
    """List the points that all chapters need."""
    if not sequences:
        raise ConfigError("there is no sequence to reproduce anything on")
    return expand([sweep for chapter in chapters() for sweep in chapter.sweeps(preset, sequences)])


def write_reproduction(
    folder: Path, command: str, points: Sequence[Point], *, page: bool = True
) -> list[Path]:
    """Write the report, the page and the document of the thesis from what has been measured."""
    from dvc.rd.reference_rows import reference_results
    from dvc.rd.report import write_reports
    from dvc.rd.results import read_folders

    collection = read_folders([folder])
    planned = planned_results(collection.results, points)
    if not planned:
        raise DvcError(f"{folder}: none of the points of the plan has a result")
    results = [*planned, *reference_results(planned, None)]
    document = folder / DOCUMENT
    text = document_text(results, folder, command, page=page)
    with atomic_output(document) as temporary:
        temporary.write_text(text, encoding="utf-8")
    reports = [folder / PAGE, folder / REPORT] if page else [folder / REPORT]
    write_reports(results, reports, notes=collection.notes)
    return [document, *reports]


def planned_results(results: Sequence[PointResult], points: Sequence[Point]) -> list[PointResult]:
    """Return the results of planned points."""
    wanted = {(source_name(point.sequence), values_digest([point.to_dict()])) for point in points}
    return [
        result
        for result in results
        if (result.data["sequence"]["name"], values_digest([result.data["options"]])) in wanted
    ]


def document_text(results: Sequence[PointResult], folder: Path, command: str, *, page: bool = True) -> str:
    """Return the document of the thesis; its pictures are written beside it."""
    there = f"[the page]({PAGE})" if page else f"[the report]({REPORT})"
    also = f", or [{REPORT}]({REPORT})" if page else ""
    parts = [
        "# The thesis, reproduced\n",
        f"Made by `{command}`: {measured_text(results)} All curves, points and commands: {there}{also}.\n",
    ]
    for chapter in chapters():
        rows = [[figure.number, figure.shows, figure.place.format(page=there)] for figure in chapter.figures]
        parts += [f"## {chapter.title}\n", table(["in the thesis", "shows", "here"], rows)]
        parts.append(chapter.section(results, folder))
    return "\n".join(parts)
