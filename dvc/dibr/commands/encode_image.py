"""`dvc-dibr encode-image`: a picture and its depth map to a stream."""

import argparse
import sys

from dvc import cli
from dvc.dibr.commands import depth_images
from dvc.dibr.commands.dibr_options import add_figures, check_size, parse_share

SUMMARY = "a picture with its depth map to a stream"
DESCRIPTION = """\
Code a picture and its depth map by wavelets that stop at the contours of the map, which both share. Any view
from near by can be rendered from the stream.
"""
EXAMPLES = """\
  dvc-dibr encode-image left.png --depth disparity.pfm scene.dibr --bpp 0.5
  dvc-dibr encode-image left.png --depth quarters.png --depth-scale 0.25 scene.dibr --bpp 0.5
  dvc-dibr encode-image colour.png --depth depth8.png --near-far 2:50 scene.dibr --bpp 0.5
"""
AUTOMATIC = "auto"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("image", metavar="IMAGE", help="the picture")
    parser.add_argument("out", metavar="OUT.dibr", help="stream to write")
    text = "its disparities, or inverse depth (--near-far), never distances: .pfm, or 8 or 16 bits of grey"
    parser.add_argument("--depth", metavar="MAP", required=True, help=text)
    depth_images.add_scale_options(parser)
    depth_images.add_codec_options(parser)
    order = "degree of the polynomials that continue the picture at edges, 0 to 3"
    cli.add_integer(parser, "--order-image", (0, 3), order, default=0, metavar="K")
    share = (
        "part of the bits that edges and depth have, or auto: that which is best for views from near by; "
        "default: 0.2"
    )
    parser.add_argument("--depth-share", type=parse_share_or_auto, default=0.2, metavar="S", help=share)
    parser.add_argument("--gray", action="store_true", help="code luma alone")
    add_figures(parser, "show no progress and print no summary")


def parse_share_or_auto(text: str) -> float | None:
    """Read a share, or that it is to be chosen."""
    return None if text == AUTOMATIC else parse_share(text)


def run(arguments: argparse.Namespace) -> int:
    """Encode."""
    from dvc.dibr.depth_image.depth_image_decoder import decode
    from dvc.dibr.depth_image.depth_image_encoder import DepthImage, PictureOptions
    from dvc.images.colour import luma
    from dvc.picture_files import read_picture

    depth_images.check_files(arguments, [arguments.image, arguments.depth])
    picture = read_picture(arguments.image)
    found, scale = depth_images.read_map(arguments.depth, arguments)
    check_size(arguments.depth, found.depth.shape, picture.shape[:2], arguments.image)
    if arguments.near_far is None:
        _warn_of_reach(arguments.depth, abs(scale.disparity(found.depth)).max(), picture.shape[1])
    is_gray = arguments.gray or bool((picture == picture[:, :, :1]).all())
    image = DepthImage(found.depth, scale, luma(picture) if is_gray else picture)
    options = PictureOptions(arguments.order_image, arguments.depth_share)
    encoded = depth_images.encode(arguments, image, options)
    entries = depth_images.figures(encoded, decode(encoded.stream), found, picture)
    depth_images.report(arguments, entries)
    return 0


def _warn_of_reach(path: str, reach_px: float, width: int) -> None:
    """Say on standard error that disparities are wider than the picture."""
    if reach_px > width:
        sys.stderr.write(
            f"dvc-dibr: {path}: disparities of up to {reach_px:.0f} pixels, the picture is {width} wide;"
            " --depth-scale tells how many a number stands for\n"
        )
