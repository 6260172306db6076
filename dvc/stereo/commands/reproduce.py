"""`dvc-stereo reproduce`: tables and figures of chapter 2 of the thesis."""

import argparse
import sys
from pathlib import Path

from dvc import cli
from dvc.errors import ConfigError

SUMMARY = "tables and figures of the thesis"
DESCRIPTION = "Tables 2.1 to 2.3 and figures 2.2 and 2.4 to 2.11 of the thesis, measured again."
EXAMPLES = """\
  dvc-stereo reproduce --data ../shared/stereo --out results/chapter2
"""
SETS = ("tsukuba", "venus", "teddy", "cones")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("--data", metavar="DIR", required=True, help=f"with the folders {', '.join(SETS)}")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    cli.add_integer(parser, "--jobs", (1, 64), "processor cores that may be used", default=1)
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no tables")


def run(arguments: argparse.Namespace) -> int:
    """Reproduce."""
    from dvc.files import atomic_folder
    from dvc.stereo.thesis.reproduce import STEPS, reproduce
    from dvc.stereo.thesis.tables import markdown

    data = Path(arguments.data)
    missing = [name for name in SETS if not (data / name).is_dir()]
    if missing:
        raise ConfigError(f"{data}: expected the folders {', '.join(SETS)}; there is no {missing[0]}")
    with (
        atomic_folder(arguments.out) as folder,
        cli.progress_bar("chapter 2", len(STEPS), arguments.quiet) as advance,
    ):
        tables = reproduce(data, folder, arguments.jobs, advance)
    if not arguments.quiet:
        sys.stdout.write("\n".join(map(markdown, tables)))
    return 0
