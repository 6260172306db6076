"""`dvc-dibr evaluate`: figures and tables of chapters 3 and 4, on sets or on own material, and of streams."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import array_files, cli
from dvc.dibr.commands import evaluate_streams
from dvc.dibr.commands.options import add_json, add_memory, json_files, parse_multiplier
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.thesis.chapter4.material import Material
    from dvc.dibr.thesis.scenes import Scene
    from dvc.page.gallery import Table

SUMMARY = "figures and tables of a chapter, or of streams"
DESCRIPTION = """\
Measure everything that a chapter shows. Chapter 3: rate-distortion curves of all ways to code disparities,
quality layers, resolutions, the split of the rate, rendered views; and other codecs in as many bytes.
Chapter 4: depth maps and pictures by wavelets that stop at shared edges, and by standard ones. Without views
or maps, on real sets (--data), or on a rendered array and the Motorcycle pair of scikit-image. Or compare
streams of any kind (--streams).
"""
EXAMPLES = """\
  dvc-dibr evaluate --out chapter3
  dvc-dibr evaluate --data ../shared/stereo --sets teddy tsukuba --out results/chapter3
  dvc-dibr evaluate left.png right.png --disparities 0:60 --lambdas 1e-2 2e-3 4e-4 --out own
  dvc-dibr evaluate --chapter 4 --map disparity.pfm --image left.png --out chapter4
  dvc-dibr evaluate --streams a.dibr b.dibr --truth-depth disparity.pfm
  dvc-dibr evaluate --streams layers-*.dibr --truth-image left.png --out curves
"""
CHAPTERS = 3, 4
OF_VIEWS = "--disparities", "--lattice", "--views", "--lambdas", "--no-peers"
OF_MAPS = "--map", "--image", "--rates"
OF_STREAMS = "--truth-depth", "--truth-image"
OF_SETS = "--data", "--sets"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("paths", nargs="*", metavar="VIEW", help="own views, the reference first")
    chapter = "which chapter; default: %(default)s"
    parser.add_argument("--chapter", type=int, choices=CHAPTERS, default=CHAPTERS[0], help=chapter)
    array_files.add_array_options(parser)
    parser.add_argument("--data", metavar="DIR", help="folder with the folders of the real sets")
    sets = (
        "which sets; default: teddy tsukuba cones cgtoy (chapter 3) or teddy (4) with --data, else toy "
        "motorcycle (3) or motorcycle (4)"
    )
    parser.add_argument("--sets", nargs="+", metavar="NAME", help=sets)
    lambdas = (
        "of the points of curves; default: where the reference has 0.1, 0.25, 0.5, 0.75, 1 bit per pixel"
    )
    parser.add_argument("--lambdas", nargs="+", type=parse_multiplier, metavar="L", help=lambdas)
    parser.add_argument("--no-peers", action="store_true", help="do not measure other codecs")
    own_map = "chapter 4: own map, .pfm or grey levels of 8 or 16 bits, where 0 is a hole"
    parser.add_argument("--map", metavar="MAP", help=own_map)
    parser.add_argument("--image", metavar="IMAGE", help="picture of that map")
    rates = "bits per pixel of the map's files; default: 0.02 to 0.25"
    parser.add_argument("--rates", nargs="+", type=cli.parse_positive, metavar="R", help=rates)
    streams = "tell rates, bits by part, and PSNR against the truth, of streams"
    parser.add_argument("--streams", nargs="+", metavar="STREAM", help=streams)
    parser.add_argument("--truth-depth", metavar="MAP", help="map of the streams")
    parser.add_argument("--truth-image", metavar="IMAGE", help="picture of the streams")
    parser.add_argument(
        "--out", metavar="DIR", help="folder to write, new or empty; with --streams if wanted"
    )
    add_memory(parser)
    add_json(parser)
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no tables")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate."""
    if arguments.streams is not None:
        _refuse(arguments, (*OF_VIEWS, *OF_MAPS, *OF_SETS), "--streams")
        return evaluate_streams.run(arguments)
    _refuse(arguments, OF_STREAMS, "a chapter")
    if arguments.out is None:
        raise ConfigError("--out is needed")
    own = [path for path in (*arguments.paths, arguments.map, arguments.image) if path is not None]
    cli.check_outputs(own, [arguments.out, *json_files(arguments)])
    if arguments.chapter == CHAPTERS[0]:
        _refuse(arguments, OF_MAPS, "chapter 3")
        tables = _chapter3(arguments)
    else:
        _refuse(arguments, OF_VIEWS, "chapter 4")
        tables = _chapter4(arguments)
    if arguments.json != "-" and not arguments.quiet:
        from dvc.stereo.thesis.tables import markdown

        sys.stdout.write("\n".join(map(markdown, tables)))
    return 0


def _refuse(arguments: argparse.Namespace, names: tuple[str, ...], where: str) -> None:
    """Complain of options that mean nothing there."""
    given = [name for name in names if getattr(arguments, name[2:].replace("-", "_"))]
    if OF_VIEWS[0] in names and arguments.paths:
        given.append("VIEW")
    if given:
        raise ConfigError(f"{given[0]}: not for {where}")


def _chapter3(arguments: argparse.Namespace) -> list["Table"]:
    from dvc.dibr.thesis.chapter import measure_scene, num_steps, write_chapter
    from dvc.files import atomic_folder

    lambdas = arguments.lambdas
    if lambdas is not None and len(set(lambdas)) < 2:
        raise ConfigError("--lambdas: at least two are needed for a curve")
    with atomic_folder(arguments.out) as folder:
        scenes = _scenes(arguments)
        total = len(scenes) * num_steps(lambdas and len(lambdas))
        with cli.progress_bar("chapter 3", total, arguments.quiet) as advance:
            results = [measure_scene(scene, lambdas, not arguments.no_peers, advance) for scene in scenes]
        tables = write_chapter(folder, results)
    if arguments.json is not None:
        cli.write_json(arguments.json, {one.scene.name: one.to_dict() for one in results})
    return tables


def _chapter4(arguments: argparse.Namespace) -> list["Table"]:
    from dvc.dibr.thesis.chapter4.chapter import measure_material, num_steps, values, write_chapter
    from dvc.files import atomic_folder

    rates = arguments.rates
    if rates is not None and len(set(rates)) < 2:
        raise ConfigError("--rates: at least two are needed for a curve")
    with atomic_folder(arguments.out) as folder:
        material = _material(arguments)
        total = len(material) * num_steps(rates and len(rates))
        with cli.progress_bar("chapter 4", total, arguments.quiet) as advance:
            results = [measure_material(one, rates, advance) for one in material]
        tables = write_chapter(folder, results)
    if arguments.json is not None:
        cli.write_json(arguments.json, values(results))
    return tables


def _scenes(arguments: argparse.Namespace) -> list["Scene"]:
    """Load what chapter 3 is to be measured on."""
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


def _material(arguments: argparse.Namespace) -> list["Material"]:
    """Load what chapter 4 is to be measured on."""
    from dvc.dibr.thesis.chapter4.material import load_material, material_of_files

    if arguments.map is None:
        if arguments.image is not None:
            raise ConfigError("--image is the picture of --map, and there is none")
        return load_material(arguments.data and Path(arguments.data), arguments.sets)
    if arguments.data is not None or arguments.sets is not None:
        raise ConfigError("an own map is evaluated, or sets (--data, --sets): not both")
    return [material_of_files(arguments.map, arguments.image)]
