"""Command `dvc-stereo`: surfaces, layers and sprites from the views of a planar camera array."""

import sys

from dvc import subcommands
from dvc.stereo.commands import evaluate, layers, reconstruct, rectify, sprites

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
    subcommands.by_name((rectify, reconstruct, layers, sprites, evaluate)),
    "stereo",
)

if __name__ == "__main__":
    sys.exit(main())
