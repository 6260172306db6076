"""Command `dvc-dibr`: views and their depth in one stream, from which any view can be rendered."""

import sys

from dvc import subcommands
from dvc.dibr.commands import (
    dibr_decode,
    dibr_encode,
    dibr_evaluate,
    dibr_render,
    dibr_view,
    encode_depth,
    encode_image,
    encode_layers,
    info,
)

EXAMPLES = """\
  dvc-dibr encode left.png right.png pair.dibr --disparities 0:60 --bpp 0.5
  dvc-dibr encode-image left.png --depth disparity.pfm scene.dibr --bpp 0.5
  dvc-dibr encode-layers layers scene.dibr --bpp 0.5
  dvc-dibr info pair.dibr
  dvc-dibr decode pair.dibr --out decoded
  dvc-dibr render pair.dibr --view 0.5,0 --out between.png
  dvc-dibr view pair.dibr --out pair.html
  dvc-dibr evaluate pair.dibr other.dibr --truth-image left.png
  dvc-dibr render pair.dibr --path 0,0 1,0 --frames 50 --out flight.mp4
"""

main = subcommands.command(
    "dvc-dibr",
    "Views and their depth, coded together; any view rendered from them.",
    EXAMPLES,
    {
        "encode": subcommands.Subcommand.of(dibr_encode),
        "encode-image": subcommands.Subcommand.of(encode_image),
        "encode-depth": subcommands.Subcommand.of(encode_depth),
        "encode-layers": subcommands.Subcommand.of(encode_layers),
        "decode": subcommands.Subcommand.of(dibr_decode),
        "render": subcommands.Subcommand.of(dibr_render),
        "view": subcommands.Subcommand.of(dibr_view),
        "info": subcommands.Subcommand.of(info),
        "evaluate": subcommands.Subcommand.of(dibr_evaluate),
    },
    "stereo",
)

if __name__ == "__main__":
    sys.exit(main())
