"""Options of the subcommands of `dvc-stereo`, checks of their outputs, and results."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dvc import array_files, cli
from dvc.errors import ConfigError
from dvc.files import check_folder
from dvc.stereo.surfaces.stereo_settings import COST_NAMES, INFERENCE_NAMES, OCCLUSION_NAMES, StereoSettings


def add_rectify_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dvc-stereo rectify`."""
    parser.add_argument("paths", nargs="+", metavar="VIEW", help="picture of a camera")
    array_files.add_camera_option(parser, required=True)
    array_files.add_lattice_options(parser, "found from the cameras")
    _add_output_options(parser, figures=False)


def add_reconstruct_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dvc-stereo reconstruct`."""
    views = "picture of a camera; or the folder of `dvc-stereo rectify`"
    parser.add_argument("paths", nargs="+", metavar="VIEW", help=views)
    array_files.add_array_options(parser)
    array_files.add_camera_option(parser)
    _add_truth_options(parser, required=False)
    _add_output_options(parser)
    group = parser.add_argument_group("method")
    cost = "census: robust, summed over regions of one colour; squared: single pixels; default: census"
    group.add_argument("--cost", choices=COST_NAMES, default="census", help=cost)
    group.add_argument(
        "--inference",
        choices=INFERENCE_NAMES,
        default=StereoSettings.inference,
        help="messages between neighbours, or only scanlines, which is faster; default: %(default)s",
    )
    group.add_argument(
        "--occlusion",
        choices=OCCLUSION_NAMES,
        default=OCCLUSION_NAMES[0],
        help="visibility from surfaces, the better one of opposite views, or none; default: %(default)s",
    )
    cli.add_integer(
        group,
        "--iterations",
        (1, 20),
        "largest number of iterations; large views begin with their smallest size, for which this counts, and"
        " take two more for each larger one",
        default=3,
    )
    group.add_argument("--sub-pixel", action="store_true", help="disparities between those of --disparities")
    cli.add_integer(group, "--jobs", (1, 256), "threads; the result is the same", default=1)


def add_folder_options(source: str, parser: argparse.ArgumentParser) -> None:
    """Add the options of subcommands that read a folder."""
    parser.add_argument("path", metavar="DIR", help=source)
    _add_output_options(parser)


def add_evaluate_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dvc-stereo evaluate`."""
    parser.add_argument("path", metavar="MAP.pfm", help="disparity map")
    _add_truth_options(parser)
    thresholds = "pixels with larger errors are bad; in pixels, default: 0.5,1,2"
    parser.add_argument(
        "--thresholds", type=_parse_thresholds, default=(0.5, 1.0, 2.0), metavar="T,T", help=thresholds
    )
    _add_json_option(parser)
    confidence = "8-bit picture: evaluate its order of errors, as the area under the sparsification curve"
    parser.add_argument("--confidence", metavar="PNG", help=confidence)
    parser.add_argument("--error-map", metavar="PNG", help="draw the pixels with errors above 1 px")


def _parse_thresholds(text: str) -> tuple[float, ...]:
    """Read thresholds."""
    values = tuple(dict.fromkeys(cli.parse_number(part) for part in text.split(",")))
    if min(values) < 0.0:
        raise argparse.ArgumentTypeError(f"expected thresholds in pixels such as 0.5,1,2, got {text!r}")
    return values


def _add_truth_options(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add the options for the truth."""
    parser.add_argument(
        "--truth", metavar="MAP", required=required, help="8-bit or 16-bit picture, or PFM file"
    )
    scale = "disparity = value / S + offset; needed for pictures, 1 for PFM files"
    parser.add_argument("--truth-scale", type=cli.parse_number, metavar="S", help=scale)
    offset = "added after the division; default: 0"
    parser.add_argument("--truth-offset", type=cli.parse_number, default=0.0, metavar="O", help=offset)
    unknown = "value that means unknown, or none; default: 0"
    parser.add_argument("--truth-unknown", type=_parse_unknown, default=0.0, metavar="V", help=unknown)
    parser.add_argument("--mask", metavar="PNG", help="only pixels of value 255 count")


def _parse_unknown(text: str) -> float | None:
    return None if text == "none" else cli.parse_number(text)


def _add_output_options(parser: argparse.ArgumentParser, *, figures: bool = True) -> None:
    """Add the options for a folder, for figures and meshes, and `--quiet`."""
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    if figures:
        _add_json_option(parser)
        mesh = "mesh for other programs; needs the extra dvc3d[mesh]"
        parser.add_argument("--ply", metavar="FILE", help=mesh)
        parser.add_argument("--glb", metavar="FILE", help="the same for the web and for viewers")
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no summary")


def _add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--json`."""
    text = "write the results; - for standard output, instead of text"
    parser.add_argument("--json", metavar="FILE", help=text)


def write_results(json: str | None, results: dict[str, Any], text: str) -> None:
    """Write results as `--json` asks, and a text, if any, unless JSON is on standard output."""
    if json is not None:
        cli.write_json(json, results)
    if json != "-" and text:
        sys.stdout.write(text + "\n")


def check_outputs(arguments: argparse.Namespace, inputs: Sequence[str | Path]) -> list[Path]:
    """Refuse folders and files that cannot be written, before any work is done; return the meshes."""
    check_folder(arguments.out)
    meshes = [(Path(name), f".{kind}") for kind in ("ply", "glb") if (name := getattr(arguments, kind))]
    for path, ending in meshes:
        if path.suffix.lower() != ending:
            raise ConfigError(f"expected a name that ends in {ending}, got {path}")
    if meshes:
        from dvc.stereo.meshes import trimesh_module

        trimesh_module()
    paths = [path for path, _ in meshes]
    named = [] if arguments.json in (None, "-") else [arguments.json]
    cli.check_outputs(cli.with_contents(inputs), [*paths, *named])
    return paths
