"""Command `dvc-stereo`: surfaces, layers and sprites from the views of a planar camera array."""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module

from dvc import subcommands
from dvc.stereo import stereo_options
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


def _lazily(module: str, name: str) -> Callable[[argparse.Namespace], int]:
    """Return a function of a module, which is imported when the function is called: help is quick."""

    def _run(arguments: argparse.Namespace) -> int:
        status: int = getattr(import_module(f"dvc.stereo.{module}"), name)(arguments)
        return status

    return _run


SUBCOMMANDS = {
    "rectify": Subcommand(
        "rectified views of calibrated or plain pictures",
        "Rectified views of cameras in a plane.",
        stereo_options.add_rectify_options,
        _lazily("reconstruct_commands", "run_rectify"),
        _RECTIFY_EXAMPLES,
    ),
    "reconstruct": Subcommand(
        "surfaces of all views",
        "Surfaces of all views, consistent with each other and with the points that they hide.",
        stereo_options.add_reconstruct_options,
        _lazily("reconstruct_commands", "run_reconstruct"),
        _RECONSTRUCT_EXAMPLES,
    ),
    "layers": Subcommand(
        "layered depth image from surfaces",
        _LAYERS_DESCRIPTION,
        partial(stereo_options.add_folder_options, "folder of `dvc-stereo reconstruct`"),
        _lazily("layer_commands", "run_layers"),
        _LAYERS_EXAMPLES,
    ),
    "sprites": Subcommand(
        "sprites with depth from layers",
        _SPRITES_DESCRIPTION,
        partial(stereo_options.add_folder_options, _SPRITES_SOURCE),
        _lazily("layer_commands", "run_sprites"),
        _SPRITES_EXAMPLES,
    ),
    "evaluate": Subcommand(
        "a disparity map against the truth",
        "Bad pixels and mean absolute error of a disparity map.",
        stereo_options.add_evaluate_options,
        _lazily("evaluation", "run"),
        _EVALUATE_EXAMPLES,
    ),
}
main = subcommands.command("dvc-stereo", "Stereo from planar camera arrays.", EXAMPLES, SUBCOMMANDS, "stereo")

if __name__ == "__main__":
    sys.exit(main())
