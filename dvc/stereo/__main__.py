"""Command `dvc-stereo`: surfaces, layers and sprites from the views of a planar camera array."""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module

from dvc import array_files, cli, subcommands
from dvc.stereo.surfaces.stereo_settings import COST_NAMES, INFERENCE_NAMES, OCCLUSION_NAMES, StereoSettings
from dvc.subcommands import Subcommand

EXAMPLES = """\
  dvc-stereo rectify *.jpg --cameras auto --out rectified
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo layers surfaces --out layers
  dvc-stereo sprites layers --out sprites
  dvc-stereo evaluate surfaces/disparity-left.pfm --truth disp2.png --truth-scale 4
"""
_RECTIFY_EXAMPLES = """\
  dvc-stereo rectify *.jpg --cameras auto --out rectified
  dvc-stereo rectify a.png b.png --cameras cameras.json --out rectified
  dvc-stereo rectify *.png --cameras sparse/0 --views views.csv --out rectified
"""
_RECONSTRUCT_EXAMPLES = """\
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo reconstruct a.png b.png c.png --lattice -1,0 0,0 1,0 --disparities -4:12:0.5 --out surfaces
  dvc-stereo reconstruct *.png --views views.csv --disparities 0:16 --out surfaces --ply surfaces.ply
  dvc-stereo reconstruct im2.png im6.png --disparities 0:60 --truth disp2.png --truth-scale 4 --out teddy
  dvc-stereo reconstruct *.jpg --cameras auto --out surfaces
  dvc-stereo reconstruct rectified --out surfaces
"""
_LAYERS_EXAMPLES = """\
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo layers surfaces --out layers
  dvc-stereo layers surfaces --out layers --json counts.json --glb layers.glb
"""
_LAYERS_DESCRIPTION = """\
Merge the surfaces of all views in the frame of the view nearest to (0, 0): several values of disparity and
colour a pixel, from near to far. docs/stereo.md describes the files.
"""
_SPRITES_SOURCE = "folder of `dvc-stereo layers` or `dvc-stereo reconstruct`"
_SPRITES_EXAMPLES = """\
  dvc-stereo layers surfaces --out layers
  dvc-stereo sprites layers --out sprites
  dvc-stereo sprites surfaces --out sprites --json - --glb sprites.glb
"""
_SPRITES_DESCRIPTION = """\
Cut the layered depth image of a scene into surfaces without discontinuities. docs/stereo.md describes the
files.
"""
_EVALUATE_EXAMPLES = """\
  dvc-stereo evaluate surfaces/disparity-left.pfm --truth disp2.png --truth-scale 4 --mask nonocc.png
  dvc-stereo evaluate disparity-l.pfm --truth truth.pfm --confidence confidence-l.png
  dvc-stereo evaluate map.pfm --truth disp.png --truth-scale 1024 --truth-offset -16 --truth-unknown none
  dvc-stereo evaluate disparity.pfm --truth truth.pfm --thresholds 0.03,0.07 --json -
"""


def _add_rectify_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dvc-stereo rectify`."""
    parser.add_argument("paths", nargs="+", metavar="VIEW", help="picture of a camera")
    array_files.add_camera_option(parser, required=True)
    array_files.add_lattice_options(parser, "found from the cameras")
    _add_output_options(parser, figures=False)


def _add_reconstruct_options(parser: argparse.ArgumentParser) -> None:
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
        "largest number of iterations, at the smallest size of large views; larger sizes take two more each",
        default=3,
    )
    group.add_argument("--sub-pixel", action="store_true", help="disparities between those of --disparities")
    cli.add_integer(group, "--jobs", (1, 256), "threads; the result is the same", default=1)


def _add_folder_options(source: str, parser: argparse.ArgumentParser) -> None:
    """Add the options of subcommands that read a folder."""
    parser.add_argument("path", metavar="DIR", help=source)
    _add_output_options(parser)


def _add_evaluate_options(parser: argparse.ArgumentParser) -> None:
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


def _lazily(module: str, name: str) -> Callable[[argparse.Namespace], int]:
    """Return a function of a module, which is imported when the function is called: help is quick."""

    def _run(arguments: argparse.Namespace) -> int:
        return int(getattr(import_module(f"dvc.stereo.{module}"), name)(arguments))

    return _run


SUBCOMMANDS = {
    "rectify": Subcommand(
        "rectified views of calibrated or plain pictures",
        "Rectified views of cameras in a plane.",
        _add_rectify_options,
        _lazily("reconstruct_commands", "run_rectify"),
        _RECTIFY_EXAMPLES,
    ),
    "reconstruct": Subcommand(
        "surfaces of all views",
        "Surfaces of all views, consistent with each other and with the points that they hide.",
        _add_reconstruct_options,
        _lazily("reconstruct_commands", "run_reconstruct"),
        _RECONSTRUCT_EXAMPLES,
    ),
    "layers": Subcommand(
        "layered depth image from surfaces",
        _LAYERS_DESCRIPTION,
        partial(_add_folder_options, "folder of `dvc-stereo reconstruct`"),
        _lazily("layer_commands", "run_layers"),
        _LAYERS_EXAMPLES,
    ),
    "sprites": Subcommand(
        "sprites with depth from layers",
        _SPRITES_DESCRIPTION,
        partial(_add_folder_options, _SPRITES_SOURCE),
        _lazily("layer_commands", "run_sprites"),
        _SPRITES_EXAMPLES,
    ),
    "evaluate": Subcommand(
        "a disparity map against the truth",
        "Bad pixels and mean absolute error of a disparity map.",
        _add_evaluate_options,
        _lazily("evaluation", "run"),
        _EVALUATE_EXAMPLES,
    ),
}
main = subcommands.command("dvc-stereo", "Stereo from planar camera arrays.", EXAMPLES, SUBCOMMANDS, "stereo")

if __name__ == "__main__":
    sys.exit(main())
