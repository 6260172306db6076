"""Command `python -m benchmarks.thesis`: tables and figures of the thesis, printed, as written, and ours."""

import argparse
import re
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import cli
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from benchmarks.thesis.harness import Task

PROG = "python -m benchmarks.thesis"
CHAPTERS = range(2, 6)
DESCRIPTION = """\
Measure every table and figure of the thesis: each number as it is printed, by its method as it is written,
and by ours. Each chapter has a folder with a document, a page, and the numbers. Started again, the command
resumes where it stopped.
"""
EXAMPLES = """\
  python -m benchmarks.thesis --data ../shared/stereo --out results/thesis   all chapters, quickly
  python -m benchmarks.thesis --chapter 2 --data ../shared/stereo --preset full   25 cameras
  python -m benchmarks.thesis --chapter 3 --as thesis --data ../shared/stereo teddy --out thesis
  python -m benchmarks.thesis --chapter 3 left.png right.png --disparities 0:60 --out views   your views
  python -m benchmarks.thesis --chapter 4 disparity.pfm left.png --out map   your map and its picture
  python -m benchmarks.thesis --chapter 5 street box --frames 11 --jobs 2 --out thesis
"""


def _parse_chapters(text: str) -> list[int]:
    match = re.fullmatch(r"(\d)(?:\.\.(\d))?", text)
    chosen = list(range(int(match[1]), int(match[2] or match[1]) + 1)) if match else []
    if not chosen or not set(chosen) <= set(CHAPTERS):
        raise argparse.ArgumentTypeError(
            f"expected a chapter from 2 to 5, or a range such as 2..4, got {text!r}"
        )
    return chosen


def _parse_range(text: str) -> str:
    """Refuse a text that is no range of disparities."""
    from dvc.array_files import parse_disparities

    parse_disparities(text)
    return text


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, DESCRIPTION, EXAMPLES)
    add = parser.add_argument
    names = "real sets (chapters 2 to 4) or sequences (5) instead of the preset's; or your files"
    add("chosen", nargs="*", metavar="NAME", help=names)
    chapters = "2 to 5, or 2..4; default: all"
    add("--chapter", type=_parse_chapters, default=list(CHAPTERS), metavar="N", help=chapters)
    add(
        "--as", dest="method", choices=["thesis", "ours", "both"], default="both", help="default: %(default)s"
    )
    presets = "minutes a chapter, or hours; default: %(default)s"
    add("--preset", choices=["quick", "full"], default="quick", help=presets)
    add("--out", type=Path, required=True, metavar="DIR", help="results; those of an earlier run are used")
    data = "folder with the folders of the real sets; default: rendered scenes"
    add("--data", type=Path, metavar="DIR", help=data)
    disparities = "chapter 3, your views: disparities, in pixels"
    add("--disparities", type=_parse_range, metavar="MIN:MAX", help=disparities)
    add("--frames", type=cli.integer(2, 10**6), metavar="N", help="chapter 5: frames of each sequence")
    cli.add_integer(parser, "--jobs", (1, 256), "processor cores that may be used", default=1)
    add("--dask", metavar="ADDRESS", help="chapter 5: measure on a Dask cluster")
    add("--quiet", action="store_true", help="show neither progress nor the names of written files")
    return parser


def _task(arguments: argparse.Namespace, number: int) -> "Task":
    from benchmarks.thesis.harness import Task

    for name in arguments.chosen:
        if Path(name).suffix and not Path(name).exists():
            raise ConfigError(f"{name}: no such file")
    return Task(
        arguments.out / f"chapter{number}",
        arguments.data,
        tuple(arguments.chosen),
        arguments.preset == "full",
        arguments.jobs,
        arguments.frames,
        arguments.dask,
        arguments.disparities,
    )


def _work(arguments: argparse.Namespace) -> int:
    from benchmarks.thesis.harness import METHODS, PAGE, Method, measure, planned

    methods = METHODS if arguments.method == "both" else (Method(arguments.method),)
    planning = []
    for number in arguments.chapter:
        chapter, task = import_module(f"benchmarks.thesis.chapter{number}").CHAPTER, _task(arguments, number)
        planning.append((chapter, task, len(planned(chapter, task, methods))))  # refuses bad requests early
    failures = list[str]()
    for chapter, task, num_steps in planning:
        with cli.progress_bar(f"chapter {chapter.number}", num_steps, arguments.quiet) as advance:
            failures += measure(chapter, task, methods, advance)
        if not arguments.quiet:
            print(task.folder / f"chapter{chapter.number}.md", task.folder / PAGE, sep="\n")
    for failure in failures:
        sys.stderr.write(f"{PROG}: {cli.one_line(failure)}\n")
    return cli.EXIT_BAD_INPUT if failures else 0


main = cli.command(PROG, _parser, _work, extra="report")

if __name__ == "__main__":
    sys.exit(main())
