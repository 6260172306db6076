"""`dvc-dibr encode-depth`: a depth map to a stream."""

import argparse

from dvc.dibr.commands import depth_images
from dvc.dibr.commands.dibr_options import add_figures

SUMMARY = "a depth map to a stream"
DESCRIPTION = """\
Code a depth map by wavelets that stop at its contours, which are coded as well where that is worth the bits.
"""
EXAMPLES = """\
  dvc-dibr encode-depth disparity.pfm map.dibr --bpp 0.05
  dvc-dibr encode-depth depth.png map.dibr --bpp 0.1 --no-holes --json -
  dvc-dibr encode-depth depth.png map.dibr --bpp 0.1 --transform standard
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("map", metavar="MAP", help="depth or disparity: .pfm, or grey levels of 8 or 16 bits")
    parser.add_argument("out", metavar="OUT.dibr", help="stream to write")
    depth_images.add_codec_options(parser)
    depth_images.add_scale_options(parser)
    add_figures(parser, "show no progress and print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Encode."""
    from dvc.dibr.depth_image.depth_image_decoder import decode
    from dvc.dibr.depth_image.depth_image_encoder import DepthImage

    depth_images.check_files(arguments, [arguments.map])
    found, scale = depth_images.read_map(arguments.map, arguments)
    encoded = depth_images.encode(arguments, DepthImage(found.depth, scale))
    depth_images.report(arguments, depth_images.figures(encoded, decode(encoded.stream), found))
    return 0
