"""Command `dvc-rd`: rate-distortion experiments."""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from dvc import cli, subcommands
from dvc.config import DEFAULT_CODEC, VARIANTS
from dvc.errors import ConfigError, DvcError
from dvc.rd.specification import ANCHORS
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
  dvc-rd compare results/before results/after                                 BD-rate of the second
  dvc-rd compare results/scenes --curves 2D 3D-TE                             is the second curve better?
  dvc-rd export results/scenes --csv points.csv                               a line per point
  dvc-rd import theirs.csv --out results/scenes                               points measured elsewhere
"""


def _add_run(run: argparse.ArgumentParser) -> None:
    add = run.add_argument
    add("sequences", nargs="*", metavar="SEQUENCE", help="name of the catalogue, or a video file")
    add("--spec", type=Path, metavar="FILE.toml", help="sweeps; options given here override the file")
    add("--codec", choices=VARIANTS, help=f"default: {DEFAULT_CODEC}")
    quality = run.add_mutually_exclusive_group().add_argument
    quality("--qp", metavar="LIST", help="qualities on H.264's scale; default: 22,26,30,34,38")
    quality("--wz-q", metavar="LIST", help="DISCOVER matrices instead of --qp, such as 1,4,8 or 1-8")
    add("--key-qp", metavar="LIST", help="auto, one QP, or one for each matrix; default: auto")
    for flag, text in (
        ("--no-feedback", "code without feedback; the rate is the size of the encoder's file"),
        ("--luma-only", "leave chroma out"),
    ):
        add(flag, action="store_true", default=None, help=text)
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
    add(
        "--option",
        action="append",
        dest="options",
        metavar="NAME[=VALUE]",
        help="any other option of dvc-encode, such as references=all or noise-model=band; repeatable",
    )
    add("--side-information", metavar="METHOD", help="predict with METHOD instead of the stream's method")
    add("--anchor", action="append", dest="anchors", choices=ANCHORS, help="codec to compare with")
    add("--anchor-qp", metavar="LIST", help="default: 20-44:4 and the QPs of the sweep")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of results; existing ones are kept")
    where = run.add_mutually_exclusive_group().add_argument
    where("--jobs", type=cli.integer(1, 256), default=1, metavar="N", help="points in parallel; default: 1")
    where("--dask", metavar="ADDRESS", help="measure on a Dask cluster, such as tcp://127.0.0.1:8786")
    add("--cache", type=Path, metavar="DIR", help="rendered scenes; default: ~/.cache/dvc3d")
    add("--any-version", action="store_true", help="keep results of other versions of the code")
    add("--quiet", action="store_true", help="no progress bar")


def _run(arguments: argparse.Namespace) -> int:
    from dataclasses import fields

    from dvc.rd.originals import default_cache
    from dvc.rd.run_points import run_points
    from dvc.rd.specification import Sweep, build_sweep, expand, parse_options, read_spec

    if arguments.spec is None and not arguments.sequences:
        raise ConfigError("give at least one SEQUENCE, or --spec FILE.toml")
    given = {field.name: getattr(arguments, field.name) for field in fields(Sweep)}
    given["sequences"] = arguments.sequences or None
    given["options"] = parse_options(arguments.options) if arguments.options else None
    given = {name: value for name, value in given.items() if value is not None}
    specified = [{}] if arguments.spec is None else read_spec(arguments.spec)
    points = expand([build_sweep({**values, **given}) for values in specified])
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


def _add_report(report: argparse.ArgumentParser) -> None:
    add = report.add_argument
    add("folders", type=Path, nargs="+", metavar="DIR", help="folder of `run --out`")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="only FILE.html, or FILE.md and its plots; default: report.html and report.md in the first DIR",
    )
    add("--against", metavar="LABEL", help="reference curve, or a part of its label; default: H.264 intra")
    add(
        "--pictures",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="decoded frames in the page; default: if the results have any and the page stays small",
    )
    add("--figures", type=Path, metavar="DIR", help="folder for the plots; default: that of the .md")


def _report(arguments: argparse.Namespace) -> int:
    from dvc.rd.comparison import find_label, verdicts
    from dvc.rd.rd_curves import ANCHOR_LABEL, experiments
    from dvc.rd.rd_page import write_page
    from dvc.rd.rd_report import write_report
    from dvc.rd.rd_results import read_folders

    outputs = [arguments.folders[0] / f"report.{end}" for end in REPORTS]
    if arguments.out:
        outputs = [arguments.out]
    if outputs[0].suffix[1:] not in REPORTS:
        raise ConfigError(f"--out must be a file name that ends with .html or .md, got {str(outputs[0])!r}")
    (results, notes), figures = read_folders(arguments.folders), arguments.figures
    anchor = find_label(results, arguments.against) if arguments.against else ANCHOR_LABEL
    judged = verdicts(experiments(results))
    texts = [path for path in outputs if path.suffix == ".md"]
    written = list(outputs)
    for path in set(outputs) - set(texts):
        write_page(results, path, anchor, notes=notes, pictures=arguments.pictures, judged=judged)
    if texts or figures is not None:
        stem, folder = (texts or outputs)[0].stem, texts[0].parent if figures is None else figures
        written += write_report(results, texts, anchor, folder=folder, judged=judged, stem=stem)
    sys.stdout.write("".join(f"{name}\n" for name in written))
    return 0


def _add_compare(compare: argparse.ArgumentParser) -> None:
    add = compare.add_argument
    add("before", type=Path, metavar="A", help="folder of an experiment")
    add("after", type=Path, nargs="?", metavar="B", help="another; its curves are compared with those of A")
    which = compare.add_mutually_exclusive_group().add_argument
    which(
        "--against",
        metavar="LABEL",
        help="reference curve of A; default: the same curve, H.264 intra without B",
    )
    which(
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


def _compare(arguments: argparse.Namespace) -> int:
    from dvc.rd.comparison import at_equal, compare, comparison_csv, comparison_table
    from dvc.rd.rd_results import read_results

    before = read_results(arguments.before)
    after = None if arguments.after is None else read_results(arguments.after)
    if arguments.quality is not None:
        before = at_equal(before, arguments.quality)
        after = None if after is None else at_equal(after, arguments.quality)
    comparisons = compare(before, after, arguments.against, arguments.curves)
    if arguments.csv is not None:
        cli.write_text(arguments.csv, comparison_csv(comparisons))
    if arguments.csv != "-":
        _print_table(*comparison_table(comparisons))
    if not any(one.is_comparable for one in comparisons):
        raise DvcError("none of these curves can be compared; the table gives the reasons")
    return 0


def _print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table: drawn on a terminal, as Markdown elsewhere."""
    if not sys.stdout.isatty():
        from dvc.rd.rd_report import table

        sys.stdout.write(table(head, rows))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table(*head)
    for row in rows:
        drawn.add_row(*(Text(cli.one_line(cell)) for cell in row))
    Console().print(drawn)


def _add_export(export: argparse.ArgumentParser) -> None:
    export.add_argument("folder", type=Path, metavar="DIR", help="folder of `run --out`")
    export.add_argument("--csv", required=True, metavar="FILE", help="file to write (-: stdout)")
    export.add_argument("--frames", action="store_true", help="a line per frame instead of one per point")


def _export(arguments: argparse.Namespace) -> int:
    from dvc.rd.points_csv import results_csv
    from dvc.rd.rd_results import read_results

    text = results_csv(read_results(arguments.folder), per_frame=arguments.frames)
    cli.write_text(arguments.csv, text)
    return 0


def _add_import(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add(
        "points",
        type=Path,
        metavar="FILE.csv",
        help="a line per point with the columns sequence, codec, rate_kbps, psnr_y_db, frames (their number),"
        " and those of docs/rd.md, such as width, height and frames_per_s if DIR has no points on these"
        " frames; or opendvc: points of openDVC",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="folder of `run --out`, or a new one")


def _import(arguments: argparse.Namespace) -> int:
    from dvc.rd.points_csv import import_points, unmatched_sequences

    points = import_points(arguments.points, arguments.out)
    sys.stderr.write(f"{PROG}: {len(points)} points imported\n")
    for name in unmatched_sequences(points, arguments.out):
        line = cli.one_line(f"nothing is measured in {arguments.out} on these frames of {name}")
        sys.stderr.write(f"{PROG}: {line}\n")
    return 0


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
        "import points that were measured elsewhere",
        "Import points that were measured elsewhere, for report, compare and export.",
        _add_import,
        _import,
    ),
}

main = subcommands.command(
    PROG, "Measure and report rate-distortion curves.", EXAMPLES, _SUBCOMMANDS, "report"
)

if __name__ == "__main__":
    sys.exit(main())
