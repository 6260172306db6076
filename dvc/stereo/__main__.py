"""Command `dvc-stereo`: surfaces, layers and sprites from the views of a planar camera array."""

import sys

from dvc import subcommands
from dvc.stereo.evaluate_command import EVALUATE
from dvc.stereo.layer_commands import LAYERS, SPRITES
from dvc.stereo.reconstruct_commands import RECONSTRUCT, RECTIFY

EXAMPLES = """\
  dvc-stereo rectify *.jpg --cameras auto --out rectified
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo layers surfaces --out layers
  dvc-stereo sprites layers --out sprites
  dvc-stereo evaluate surfaces/disparity-left.pfm --truth disp2.png --truth-scale 4
"""

main = subcommands.command(
    "dvc-stereo",
    "Stereo from planar camera arrays.",
    EXAMPLES,
    {
        "rectify": RECTIFY,
        "reconstruct": RECONSTRUCT,
        "layers": LAYERS,
        "sprites": SPRITES,
        "evaluate": EVALUATE,
    },
    "stereo",
)

if __name__ == "__main__":
    sys.exit(main())
