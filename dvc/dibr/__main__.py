"""Command `dvc-dibr`: views and their depth in one stream, from which any view can be rendered."""

import sys

from dvc.dibr.commands.dibr_options import SUBCOMMANDS
from dvc.subcommands import command

EXAMPLES = """\
  dvc-dibr encode left.png right.png pair.dibr --disparities 0:60 --bpp 0.5
  dvc-dibr encode left.png scene.dibr --depth disparity.pfm --bpp 0.5
  dvc-dibr encode layers layers.dibr --bpp 0.5
  dvc-dibr info pair.dibr
  dvc-dibr decode pair.dibr --out decoded
  dvc-dibr render pair.dibr --view 0.5,0 --out between.png
  dvc-dibr render pair.dibr --path 0,0 1,0 --frames 50 --out flight.mp4
  dvc-dibr view pair.dibr --out pair.html
  dvc-dibr evaluate pair.dibr other.dibr --truth-image left.png
"""
main = command(
    "dvc-dibr",
    "Views and their depth, coded together; any view rendered from them.",
    EXAMPLES,
    SUBCOMMANDS,
    "stereo",
)

if __name__ == "__main__":
    sys.exit(main())
