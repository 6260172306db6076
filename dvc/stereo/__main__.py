"""Command `dvc-stereo`: surfaces, layers and sprites from the views of a planar camera array."""

import argparse
import sys

from dvc import cli
from dvc.stereo.commands import evaluate, layers, reconstruct, rectify, reproduce, sprites

PROG = "dvc-stereo"
EXAMPLES = """\
  dvc-stereo rectify *.jpg --cameras auto --out rectified
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo layers surfaces --out layers
  dvc-stereo sprites layers --out sprites
  dvc-stereo evaluate surfaces/disparity-left.pfm --truth disp2.png --truth-scale 4
"""
COMMANDS = (rectify, reconstruct, layers, sprites, evaluate, reproduce)


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Stereo from planar camera arrays.", EXAMPLES)
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_parser(subparsers).set_defaults(work=command.run)
    return parser


main = cli.command(PROG, _parser, lambda arguments: int(arguments.work(arguments)), has_subcommands=True)

if __name__ == "__main__":
    sys.exit(main())
