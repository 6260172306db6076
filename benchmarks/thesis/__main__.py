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
    from benchmarks.thesis.chapter import Chapter, Task, Way

PROG = "python -m benchmarks.thesis"
CHAPTERS = range(2, 6)
BOTH = "both"
AS = ("thesis", "ours", BOTH)
DESCRIPTION = """\
Measure every table and figure of the thesis: each number as it is printed, by its method as it is written,
and by ours. Each chapter has a folder with a document, a page, and the numbers. Started again, it goes on
where it stopped.
"""
EXAMPLES = """\
  python -m benchmarks.thesis --data ../shared/stereo --out results/thesis   all chapters, quickly
  python -m benchmarks.thesis --chapter 2 --data ../shared/stereo --preset full   25 cameras
  python -m benchmarks.thesis --chapter 3 --as thesis --data ../shared/stereo teddy --out thesis
  python -m benchmarks.thesis --chapter 3 left.png right.png --disparities 0:60 --out own   own views
  python -m benchmarks.thesis --chapter 4 disparity.pfm left.png --out own   an own map and its picture
  python -m benchmarks.thesis --chapter 5 street box --frames 11 --jobs 2 --out thesis
"""


def _parse_chapters(text: str) -> list[int]:
    match = re.fullmatch(r"(\d)(?:\.\.(\d))?", text)
    chosen = list(range(int(match[1]), int(match[2] or match[1]) + 1)) if match else []
    if not chosen or not set(chosen) <= set(CHAPTERS):
        raise argparse.ArgumentTypeError(
            f"expected a chapter from 2 to 5, or some, such as 2..4, got {text!r}"
        )
    return chosen


def _range(text: str) -> str:
    """Refuse what is no range of disparities."""
    from dvc.array_files import parse_disparities

    parse_disparities(text)
    return text


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, DESCRIPTION, EXAMPLES)
    add = parser.add_argument
    what = "real sets (chapters 2 to 4) or sequences (5) in place of the preset's; or own files"
    add("chosen", nargs="*", metavar="WHAT", help=what)
    add(
        "--chapter",
        type=_parse_chapters,
        default=list(CHAPTERS),
        metavar="N",
        help="2 to 5, or 2..4; default: all",
    )
    add("--as", dest="way", choices=AS, default=BOTH, help="whose methods; default: %(default)s")
    add(
        "--preset",
        choices=["quick", "full"],
        default="quick",
        help="minutes a chapter, or hours; default: %(default)s",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="results; what is there is kept")
    add(
        "--data",
        type=Path,
        metavar="DIR",
        help="folder with the folders of the real sets; default: rendered ones",
    )
    add("--disparities", type=_range, metavar="MIN:MAX", help="chapter 3, own views: disparities, in pixels")
    add("--frames", type=cli.integer(2, 10**6), metavar="N", help="chapter 5: of each sequence")
    cli.add_integer(parser, "--jobs", (1, 256), "processor cores that may be used", default=1)
    add("--dask", metavar="ADDRESS", help="chapter 5: measure on a Dask cluster")
    add("--quiet", action="store_true", help="show no progress, and do not tell what was written")
    return parser


def _work(arguments: argparse.Namespace) -> int:
    from benchmarks.thesis.chapter import BOTH as BOTH_WAYS
    from benchmarks.thesis.chapter import Way

    ways = BOTH_WAYS if arguments.way == BOTH else (Way(arguments.way),)
    chapters: list[Chapter] = [
        import_module(f"benchmarks.thesis.chapter{number}.chapter").CHAPTER for number in arguments.chapter
    ]
    tasks = [_task(arguments, chapter) for chapter in chapters]
    plans = [len(chapter.steps(task)) for chapter, task in zip(chapters, tasks, strict=True)]  # refused early
    assert all(plans)
    failures = [_measured(*pair, ways, arguments) for pair in zip(chapters, tasks, strict=True)]
    return cli.EXIT_BAD_INPUT if any(failures) else 0


def _task(arguments: argparse.Namespace, chapter: "Chapter") -> "Task":
    from benchmarks.thesis.chapter import Task

    for name in arguments.chosen:
        if Path(name).suffix and not Path(name).exists():
            raise ConfigError(f"{name}: no such file")
    return Task(
        arguments.out / f"chapter{chapter.number}",
        arguments.data,
        tuple(arguments.chosen),
        arguments.preset == "full",
        arguments.jobs,
        arguments.frames,
        arguments.dask,
        arguments.disparities,
    )


def _measured(
    chapter: "Chapter", task: "Task", ways: "tuple[Way, ...]", arguments: argparse.Namespace
) -> list[str]:
    from benchmarks.thesis.harness import measure, planned

    total = len(planned(chapter, task, ways))
    with cli.progress_bar(f"chapter {chapter.number}", total, arguments.quiet) as advance:
        failures = measure(chapter, task, ways, advance)
    for failure in failures:
        sys.stderr.write(f"{PROG}: {cli.one_line(failure)}\n")
    if not arguments.quiet:
        names = f"chapter{chapter.number}.md", "index.html"
        sys.stdout.write("".join(f"{task.folder / name}\n" for name in names))
    return failures


main = cli.command(PROG, _parser, _work, extra="report")

if __name__ == "__main__":
    sys.exit(main())
