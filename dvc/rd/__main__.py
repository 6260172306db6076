"""Command `dvc-rd`: rate-distortion experiments."""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.config import CODECS
from dvc.errors import ConfigError
from dvc.rd.points import ANCHORS

PROG = "dvc-rd"
EXAMPLES = """\
  dvc-rd run foreman_qcif15 --wz-q 1-8 --anchor intra --out results/foreman   a curve, and H.264 intra
  dvc-rd run street stairway statue --frames 51 --out results/scenes --jobs 2
  dvc-rd run box --option noise-model=band --wz-q 1,4,8 --out results/band    any option of dvc-encode
  dvc-rd run --spec sweep.toml --frames 11 --out results/quick                sweeps of a file, shortened
  dvc-rd report results/foreman                                               table and plot per sequence
  dvc-rd compare results/before results/after                                 BD-rate of the one to the other
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Measure and report rate-distortion curves.", EXAMPLES)
    commands = parser.add_subparsers(dest="command", required=True, metavar="{run,report,compare}")
    _add_run(
        commands.add_parser("run", prog=f"{PROG} run", description="Measure points.", help="measure points")
    )
    report = commands.add_parser(
        "report", prog=f"{PROG} report", description="Write tables and plots.", help="write tables and plots"
    )
    report.add_argument("folder", type=Path, metavar="DIR", help="what `run --out` was given")
    report.add_argument(
        "--out", type=Path, metavar="FILE.md", help="default: DIR/report.md; the plots lie beside it"
    )
    report.add_argument("--against", metavar="LABEL", help="curve to compare with; default: H.264 intra")
    compare = commands.add_parser(
        "compare",
        prog=f"{PROG} compare",
        description="Compare the curves that two experiments have in common.",
        help="compare two experiments",
    )
    compare.add_argument("before", type=Path, metavar="A", help="folder of the first")
    compare.add_argument("after", type=Path, metavar="B", help="folder of the second")
    return parser


def _add_run(run: argparse.ArgumentParser) -> None:
    run.add_argument(
        "sequences", nargs="*", metavar="SEQUENCE", help="name of the catalogue, or a video file"
    )
    run.add_argument(
        "--spec", type=Path, metavar="FILE.toml", help="sweeps; options given here override the file"
    )
    run.add_argument("--codec", choices=CODECS, help="default: 2d")
    run.add_argument("--wz-q", metavar="LIST", help="quantiser presets, such as 1,4,8; default: 1-8")
    run.add_argument("--key-qp", metavar="LIST", help="auto, one QP, or one for each preset; default: auto")
    run.add_argument("--gop", type=cli.integer(1, 256), metavar="N", help="default: that of dvc-encode")
    run.add_argument("--start", type=cli.integer(0, 10**9), metavar="K", help="first frame; default: 0")
    run.add_argument("--frames", type=cli.integer(1, 10**9), metavar="N", help="default: all")
    colour = run.add_mutually_exclusive_group()
    colour.add_argument("--luma-only", action="store_true", default=None, help="the default")
    colour.add_argument("--colour", dest="luma_only", action="store_false", help="code chroma as well")
    run.add_argument(
        "--option",
        action="append",
        dest="options",
        metavar="NAME[=VALUE]",
        help="any other option of dvc-encode, such as references=all or noise-model=band; repeatable",
    )
    run.add_argument(
        "--anchor", action="append", dest="anchors", choices=ANCHORS, help="codec to compare with"
    )
    run.add_argument("--anchor-qp", metavar="LIST", help="default: 20-44:4 and the QPs of the sweep")
    run.add_argument("--out", type=Path, required=True, metavar="DIR", help="results; what is there is kept")
    run.add_argument(
        "--jobs", type=cli.integer(1, 256), default=1, metavar="N", help="points at a time; default: 1"
    )
    run.add_argument("--cache", type=Path, metavar="DIR", help="rendered scenes; default: ~/.cache/dvc3d")
    run.add_argument("--any-version", action="store_true", help="keep results of other versions of the code")
    run.add_argument("--quiet", action="store_true", help="no progress bar")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process by default.

    Returns
    -------
    int
        Exit status: 0, or 2 for bad input and for points that failed.
    """
    arguments = _parser().parse_args(argv)
    command = {"run": _run, "report": _report, "compare": _compare}[arguments.command]
    return cli.run(PROG, lambda: command(arguments))


def _run(arguments: argparse.Namespace) -> int:
    from dvc.rd.points import expand
    from dvc.rd.sources import default_cache
    from dvc.rd.sweep import run_points

    points = expand(_sweeps(arguments))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with cli.progress_bar("points", len(points), arguments.quiet) as progress:
        summary = run_points(
            points,
            arguments.out,
            arguments.cache or default_cache(),
            jobs=arguments.jobs,
            any_version=arguments.any_version,
            progress=progress,
        )
    counts = f"{summary.num_measured} measured, {summary.num_skipped} already there"
    sys.stderr.write(f"{PROG}: {len(points)} points: {counts}, {len(summary.failures)} failed\n")
    return cli.EXIT_BAD_INPUT if summary.failures else 0


def _sweeps(arguments: argparse.Namespace) -> list[Any]:
    from dvc.rd.points import build_sweep, parse_options, read_spec

    names = ("codec", "wz_q", "key_qp", "gop", "start", "frames", "luma_only", "anchors", "anchor_qp")
    given = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if arguments.sequences:
        given["sequences"] = arguments.sequences
    if arguments.options:
        given["options"] = parse_options(arguments.options)
    if arguments.spec is None and not arguments.sequences:
        raise ConfigError("give at least one SEQUENCE, or --spec FILE.toml")
    specified = [{}] if arguments.spec is None else read_spec(arguments.spec)
    return [build_sweep({**fields, **given}) for fields in specified]


def _report(arguments: argparse.Namespace) -> int:
    from dvc.rd.curves import ANCHOR_LABEL
    from dvc.rd.report import write_report
    from dvc.rd.results import read_results

    path = arguments.out or arguments.folder / "report.md"
    if path.suffix != ".md":
        raise ConfigError(f"--out must be a file name that ends with .md, got {str(path)!r}")
    written = write_report(read_results(arguments.folder), path, arguments.against or ANCHOR_LABEL)
    sys.stdout.write("".join(f"{name}\n" for name in written))
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from dvc.rd.compare import compare_results
    from dvc.rd.results import read_results

    sys.stdout.write(compare_results(read_results(arguments.before), read_results(arguments.after)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
