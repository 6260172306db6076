"""`dvc-dibr evaluate`: figures and tables of chapter 3, on sets or on own views."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import array_files, cli
from dvc.dibr.commands.options import add_json, json_files, parse_slope
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.thesis.scenes import Scene

SUMMARY = "figures and tables of the chapter"
DESCRIPTION = """\
Measure everything that chapter 3 shows: rate-distortion curves of all ways to code disparities, quality
layers, resolutions, the split of the rate, rendered views; and other codecs in as many bytes. Without views,
on real sets (--data), or on a rendered array and the Motorcycle pair of scikit-image.
"""
EXAMPLES = """\
  dvc-dibr evaluate --out chapter3
  dvc-dibr evaluate --data ../shared/stereo --sets teddy tsukuba --out results/chapter3
  dvc-dibr evaluate left.png right.png --disparities 0:60 --slopes 1e-2 2e-3 4e-4 --out own
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Of the subcommand.
    """
    parser.add_argument("paths", nargs="*", metavar="VIEW", help="own views, the reference first")
    array_files.add_array_options(parser)
    parser.add_argument("--data", metavar="DIR", help="folder with the folders of the real sets")
    sets = "which sets; default: teddy tsukuba cones cgtoy with --data, else toy motorcycle"
    parser.add_argument("--sets", nargs="+", metavar="NAME", help=sets)
    slopes = "of the points of curves; default: where the reference has 0.1, 0.25, 0.5, 0.75, 1 bit per pixel"
    parser.add_argument("--slopes", nargs="+", type=parse_slope, metavar="S", help=slopes)
    parser.add_argument("--no-peers", action="store_true", help="do not measure other codecs")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    add_json(parser)
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no tables")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate.

    Parameters
    ----------
    arguments : argparse.Namespace
        As parsed.

    Returns
    -------
    int
        Exit status.
    """
    from dvc.dibr.thesis.chapter import measure_scene, num_steps, write_chapter
    from dvc.files import atomic_folder
    from dvc.stereo.thesis.tables import markdown

    cli.check_outputs(list(arguments.paths), [arguments.out, *json_files(arguments)])
    slopes = arguments.slopes
    if slopes is not None and len(set(slopes)) < 2:
        raise ConfigError("--slopes: at least two are needed for a curve")
    with atomic_folder(arguments.out) as folder:
        scenes = _scenes(arguments)
        total = len(scenes) * num_steps(slopes and len(slopes))
        with cli.progress_bar("chapter 3", total, arguments.quiet) as advance:
            results = [measure_scene(scene, slopes, not arguments.no_peers, advance) for scene in scenes]
        tables = write_chapter(folder, results)
    if arguments.json is not None:
        cli.write_json(arguments.json, {one.scene.name: one.to_dict() for one in results})
    if arguments.json != "-" and not arguments.quiet:
        sys.stdout.write("\n".join(map(markdown, tables)))
    return 0


def _scenes(arguments: argparse.Namespace) -> list["Scene"]:
    """Load what is to be measured."""
    from dvc.dibr.thesis.scenes import load_scenes, scene_of_views

    if not arguments.paths:
        own = {"--lattice": arguments.lattice, "--views": arguments.views}
        named = next((name for name, value in own.items() if value is not None), None)
        if named is not None or arguments.disparities is not None:
            raise ConfigError(f"{named or '--disparities'} is for own views, and there are none")
        return load_scenes(arguments.data and Path(arguments.data), arguments.sets)
    if arguments.data is not None or arguments.sets is not None:
        raise ConfigError("own views are evaluated, or sets (--data, --sets): not both")
    if arguments.disparities is None:
        raise ConfigError("--disparities MIN:MAX is needed, in pixels per unit of m")
    array = array_files.load_array(arguments.paths, array_files.positions_of(arguments, arguments.paths))
    return [scene_of_views(array, arguments.disparities)]
