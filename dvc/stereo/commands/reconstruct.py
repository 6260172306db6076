"""`dvc-stereo reconstruct`: surfaces of all views, consistent with each other."""

import argparse
from typing import Any

from dvc import array_files, cli

EXAMPLES = """\
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo reconstruct a.png b.png c.png --lattice -1,0 0,0 1,0 --disparities -4:12:0.5 --out surfaces
  dvc-stereo reconstruct *.png --views views.csv --disparities 0:16 --out surfaces
"""


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Add the subcommand.

    Parameters
    ----------
    subparsers : action of `add_subparsers`
        Of the command.

    Returns
    -------
    argparse.ArgumentParser
        Of the subcommand.
    """
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "reconstruct", description="Surfaces of all views.", examples=EXAMPLES, help="surfaces of all views"
    )
    parser.add_argument("paths", nargs="+", metavar="VIEW", help="picture of a camera")
    array_files.add_array_options(parser)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no summary")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Reconstruct.

    Parameters
    ----------
    arguments : argparse.Namespace
        As parsed.

    Returns
    -------
    int
        Exit status.
    """
    from dvc.files import atomic_folder
    from dvc.stereo.folder import write_reconstruction
    from dvc.stereo.reconstruction import reconstruct

    array = array_files.load_array(arguments.paths, array_files.positions_of(arguments, arguments.paths))
    with cli.progress_bar("surfaces", None, arguments.quiet) as advance:
        reconstruction = reconstruct(array, arguments.disparities, advance=advance)
    with atomic_folder(arguments.out) as folder:
        write_reconstruction(folder, reconstruction)
    return 0
