"""Command `dvc-rd`: rate-distortion experiments."""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dvc import cli, subcommands
from dvc.config import DEFAULT_CODEC, VARIANTS
from dvc.errors import ConfigError, DvcError
from dvc.rd.points import ANCHORS
from dvc.subcommands import Subcommand

PROG = "dvc-rd"
REPORTS = ("html", "md")
EXAMPLES = """\
  dvc-rd run foreman_qcif15 --wz-q 1-8 --anchor intra --out results/foreman   a curve, and H.264 intra
  dvc-rd run street stairway statue --frames 51 --out results/scenes --jobs 2
  dvc-rd run box --option noise-model=band --wz-q 1,4,8 --out results/band    any option of dvc-encode
  dvc-rd run box --no-feedback --frames 49 --out results/no-feedback
  dvc-rd run --spec sweep.toml --frames 11 --out results/quick                sweeps of a file, shortened
  dvc-rd report results/foreman                                               a page, tables and plots
  dvc-rd compare results/before results/after                                 BD-rate of the one to the other
  dvc-rd compare results/scenes --curves 2D 3D-TE                             is the second one better?
  dvc-rd export results/scenes --csv points.csv                               a line per point
  dvc-rd import theirs.csv --out results/scenes                               points of others beside ours
"""


def _add_report(report: argparse.ArgumentParser) -> None:
    add = report.add_argument
    add("folders", type=Path, nargs="+", metavar="DIR", help="what `run --out` was given")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="only FILE.html, or FILE.md and its plots; default: report.html and report.md in the first DIR",
    )
    add("--against", metavar="LABEL", help="curve to compare with, or a part of it; default: H.264 intra")
    add(
        "--pictures",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="decoded frames in the page; default: as far as the results have any, and the page stays small",
    )
    add("--figures", type=Path, metavar="DIR", help="folder for the plots; default: that of the .md")
    add(
        "--reference-rows",
        type=Path,
        metavar="FILE.csv",
        help="points of the H.264 reference software, of luma only, to show beside those of"
        " `run --luma-only`; default: what DVC_ANCHORS names",
    )


def _add_compare(compare: argparse.ArgumentParser) -> None:
    add = compare.add_argument
    add("before", type=Path, metavar="A", help="folder of an experiment")
    add("after", type=Path, nargs="?", metavar="B", help="another: its curves are compared with those of A")
    which = compare.add_mutually_exclusive_group()
    which.add_argument(
        "--against",
        metavar="LABEL",
        help="curve of A that all are compared with; default: the same curve, H.264 intra without B",
    )
    which.add_argument(
        "--curves",
        nargs=2,
        metavar=("LABEL1", "LABEL2"),
        help="within A: the second against the first; a part of a label is enough",
    )
    add(
        "--quality",
        choices=("luma", "mse", "colour"),
        help="compare at equal mean PSNR of luma, PSNR of its mean squared error, or (6 Y + Cb + Cr) / 8;"
        " default: both luma and colour",
    )
    add("--csv", metavar="FILE", help="also write the values (-: instead, to stdout)")


def _add_export(export: argparse.ArgumentParser) -> None:
    add = export.add_argument
    add("folder", type=Path, metavar="DIR", help="what `run --out` was given")
    add("--csv", required=True, metavar="FILE", help="file to write (-: stdout)")
    add("--frames", action="store_true", help="a line per frame instead of one per point")


def _add_import(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add(
        "points",
        type=Path,
        metavar="FILE.csv",
        help="a line per point, under the names of the columns: sequence, codec, rate_kbps, psnr_y_db, frames"
        " (how many), and those of docs/rd.md, such as width, height and frames_per_s where nothing in DIR"
        " is of these frames; or opendvc: points of openDVC",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="what `run --out` was given, or a new folder")


def _add_run(run: argparse.ArgumentParser) -> None:
    add = run.add_argument
    add("sequences", nargs="*", metavar="SEQUENCE", help="name of the catalogue, or a video file")
    add("--spec", type=Path, metavar="FILE.toml", help="sweeps; options given here override the file")
    add("--codec", choices=VARIANTS, help=f"default: {DEFAULT_CODEC}")
    add("--qp", metavar="LIST", help="qualities on H.264's scale; default: 22,26,30,34,38")
    add("--wz-q", metavar="LIST", help="DISCOVER matrices in place of --qp, such as 1,4,8 or 1-8")
    add("--key-qp", metavar="LIST", help="auto, one QP, or one for each matrix; default: auto")
    add(
        "--no-feedback",
        action="store_true",
        default=None,
        help="files as dvc-encode --no-feedback writes them, whose size is the rate",
    )
    add(
        "--no-proof",
        dest="proof",
        action="store_false",
        default=None,
        help="do not decode punctured streams a second time, in a fresh process without feedback",
    )
    add("--gop", type=cli.integer(1, 256), metavar="N", help="default: that of dvc-encode")
    add("--start", type=cli.integer(0, 10**9), metavar="K", help="first frame; default: 0")
    add("--frames", type=cli.integer(1, 10**9), metavar="N", help="default: all")
    add("--luma-only", action="store_true", default=None, help="leave chroma out, as x264-ippp-zero does")
    add(
        "--option",
        action="append",
        dest="options",
        metavar="NAME[=VALUE]",
        help="any other option of dvc-encode, such as references=all or noise-model=band; repeatable",
    )
    add("--side-information", metavar="METHOD", help="predict with METHOD instead of what the stream names")
    add("--anchor", action="append", dest="anchors", choices=ANCHORS, help="codec to compare with")
    add("--anchor-qp", metavar="LIST", help="default: 20-44:4 and the QPs of the sweep")
    _add_measuring(run)


def _add_measuring(command: argparse.ArgumentParser) -> None:
    """Add the options of all commands that measure points."""
    add = command.add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="results; what is there is kept")
    where = command.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=cli.integer(1, 256), default=1, metavar="N", help="points at a time; default: 1"
    )
    where.add_argument(
        "--dask", metavar="ADDRESS", help="measure on a Dask cluster, such as tcp://127.0.0.1:8786"
    )
    add("--cache", type=Path, metavar="DIR", help="rendered scenes; default: ~/.cache/dvc3d")
    add("--any-version", action="store_true", help="keep results of other versions of the code")
    add("--quiet", action="store_true", help="no progress bar")


def _run(arguments: argparse.Namespace) -> int:
    from dvc.rd.specification import expand

    return _measure(expand(_sweeps(arguments)), arguments)


def _measure(points: list[Any], arguments: argparse.Namespace) -> int:
    """Measure points, and say how that went."""
    from dvc.rd.sources import default_cache
    from dvc.rd.sweep import run_points

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with cli.progress_bar("points", len(points), arguments.quiet) as progress:
        summary = run_points(
            points,
            arguments.out,
            arguments.cache or default_cache(),
            jobs=arguments.jobs,
            any_version=arguments.any_version,
            progress=progress,
            cluster=arguments.dask,
        )
    counts = f"{summary.num_measured} measured, {summary.num_skipped} already there"
    sys.stderr.write(f"{PROG}: {len(points)} points: {counts}, {len(summary.failures)} failed\n")
    return cli.EXIT_BAD_INPUT if summary.failures else 0


def _sweeps(arguments: argparse.Namespace) -> list[Any]:
    from dvc.rd.specification import build_sweep, parse_options, read_spec

    names = [
        *("codec", "qp", "wz_q", "key_qp", "no_feedback", "gop", "start", "frames"),
        *("luma_only", "anchors", "anchor_qp", "proof", "side_information"),
    ]
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
    from dvc.rd.compare import find_label
    from dvc.rd.curves import ANCHOR_LABEL
    from dvc.rd.reference_rows import reference_results
    from dvc.rd.report import write_reports
    from dvc.rd.results import read_folders

    outputs = (
        [arguments.out] if arguments.out else [arguments.folders[0] / f"report.{end}" for end in REPORTS]
    )
    if outputs[0].suffix[1:] not in REPORTS:
        raise ConfigError(f"--out must be a file name that ends with .html or .md, got {str(outputs[0])!r}")
    collection = read_folders(arguments.folders)
    reference = reference_results(collection.results, arguments.reference_rows)
    if arguments.reference_rows and not reference:
        told = "no reference rows of these frames; they are of luma only (run --luma-only)"
        sys.stderr.write(f"{PROG}: {told}\n")
    results = [*collection.results, *reference]
    anchor = find_label(results, arguments.against) if arguments.against else ANCHOR_LABEL
    written = write_reports(
        results,
        outputs,
        anchor,
        figures=arguments.figures,
        notes=collection.notes,
        pictures=arguments.pictures,
    )
    sys.stdout.write("".join(f"{name}\n" for name in written))
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from dvc.rd.compare import at_equal, compare, comparison_csv, comparison_table
    from dvc.rd.results import read_results

    before = read_results(arguments.before)
    after = None if arguments.after is None else read_results(arguments.after)
    if arguments.quality is not None:
        before = at_equal(before, arguments.quality)
        after = None if after is None else at_equal(after, arguments.quality)
    found = compare(before, after, arguments.against, arguments.curves)
    if arguments.csv is not None:
        _write(arguments.csv, comparison_csv(found))
    if arguments.csv != "-":
        _show_table(*comparison_table(found))
    if not any(one.comparable for one in found):
        raise DvcError("none of these curves can be compared; the table says why")
    return 0


def _show_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a table on standard output: drawn on a terminal, as Markdown elsewhere."""
    if not sys.stdout.isatty():
        from dvc.rd.tables import table

        sys.stdout.write(table(head, rows))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table(*head)
    for row in rows:
        drawn.add_row(*(Text(cli.one_line(cell)) for cell in row))
    Console().print(drawn)


def _export(arguments: argparse.Namespace) -> int:
    from dvc.rd.export import results_csv
    from dvc.rd.results import read_results

    results = read_results(arguments.folder)
    _write(arguments.csv, results_csv(results, per_frame=arguments.frames))
    return 0


def _import(arguments: argparse.Namespace) -> int:
    from dvc.rd.imported import beside_nothing, import_points

    points = import_points(arguments.points, arguments.out)
    sys.stderr.write(f"{PROG}: {len(points)} points imported\n")
    for name in beside_nothing(points, arguments.out):
        told = cli.one_line(f"nothing is measured in {arguments.out} on these frames of {name}")
        sys.stderr.write(f"{PROG}: {told}\n")
    return 0


def _write(name: str, text: str) -> None:
    """Write a file in one piece, or to standard output."""
    if name == "-":
        sys.stdout.write(text)
        return
    from dvc.files import atomic_output

    with atomic_output(name) as temporary:
        temporary.write_text(text, encoding="utf-8")


_SUBCOMMANDS = {
    "run": Subcommand("measure points", "Measure points.", _add_run, _run),
    "report": Subcommand(
        "write a page, tables and plots",
        "Write tables, plots, and a page that holds all of them and opens in any browser.",
        _add_report,
        _report,
    ),
    "compare": Subcommand(
        "compare curves: which needs less, and by how much",
        "Compare the curves that two experiments have in common, or those of one experiment.",
        _add_compare,
        _compare,
    ),
    "export": Subcommand(
        "write points as CSV",
        "Write points, or their frames, as comma-separated values.",
        _add_export,
        _export,
    ),
    "import": Subcommand(
        "take over points that others have measured",
        "Take over points that others have measured, for report, compare and export.",
        _add_import,
        _import,
    ),
}

main = subcommands.command(
    PROG, "Measure and report rate-distortion curves.", EXAMPLES, _SUBCOMMANDS, "report"
)

if __name__ == "__main__":
    sys.exit(main())
