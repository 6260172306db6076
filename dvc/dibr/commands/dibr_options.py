"""Options of the subcommands of `dvc-dibr`; their modules are imported when they run."""

import argparse
import math
import re
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from dvc import array_files, cli
from dvc.dibr.dibr_streams import CODEC_NUMBERS, DEFAULT_CODEC, MAX_LAYERS, MAX_MIB
from dvc.subcommands import Subcommand

if TYPE_CHECKING:
    from dvc.geometry.camera_array import LatticePosition

TRANSFORMS = "shape-adaptive", "standard"
EDGES = "auto", "canny", "none"
WAVELETS = "9/7", "5/3"
KEEP = "auto", "all"
AUTOMATIC = "auto"
BLENDS = "distance", "nearest"


def _add_stream(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="IN.dibr", help="stream, whole or cut")
    _add_memory(parser)


def _add_memory(parser: argparse.ArgumentParser) -> None:
    text = f"memory for decoding; default: {MAX_MIB}, and pixels in proportion to the bytes of the stream"
    cli.add_integer(parser, "--max-memory", (1, 2**20), text, metavar="MIB")


def _add_layers(parser: argparse.ArgumentParser) -> None:
    text = "decode the first K quality layers; default: all"
    cli.add_integer(parser, "--quality-layers", (1, MAX_LAYERS), text, metavar="K")


def _add_hole_options(parser: argparse.ArgumentParser, default: str) -> None:
    hole = f"number of holes in the map; default: {default}"
    holes = parser.add_mutually_exclusive_group()
    holes.add_argument("--hole", type=cli.parse_number, metavar="V", help=hole)
    holes.add_argument("--no-holes", action="store_true", default=None, help="all numbers are depths")


def _add_figures(parser: argparse.ArgumentParser, quiet: str | None) -> None:
    text = "write the results as JSON; - for standard output instead of text"
    parser.add_argument("--json", metavar="FILE", help=text)
    if quiet is not None:
        parser.add_argument("--quiet", action="store_true", help=quiet)


def _add_encode_options(parser: argparse.ArgumentParser) -> None:
    files = (
        "pictures (the reference first), a depth map (.pfm, or 8 or 16 bits of grey), or a folder; OUT.dibr"
    )
    parser.add_argument("paths", nargs="+", metavar="FILE", help=files)
    bpp = "bits of the whole file per pixel of a view, at most"
    parser.add_argument("--bpp", type=cli.parse_positive, metavar="R", help=bpp)
    parser.add_argument("--gray", action="store_true", default=None, help="code only luma")
    views = parser.add_argument_group("views")
    array_files.add_array_options(parser)
    array_files.add_camera_option(parser, refined=False)
    depths = (
        "nearest and farthest depth with --cameras; FAR may be inf; LABELS even in inverse depth, "
        "by default at most a pixel apart; default: those of known points"
    )
    views.add_argument("--depths", type=parse_depths, metavar="NEAR:FAR[:LABELS]", help=depths)
    multiplier = "instead of --bpp: squared error (intensities from 0 to 1) that a bit per pixel is worth"
    views.add_argument("--lambda", dest="multiplier", type=parse_multiplier, metavar="L", help=multiplier)
    method = f"codec of disparities; default: {DEFAULT_CODEC}"
    views.add_argument("--disparity", choices=CODEC_NUMBERS, help=method)
    cli.add_integer(parser, "--quality-layers", (1, MAX_LAYERS), "layers that can be cut off; default: 1")
    references = "further views with pictures and disparities of their own"
    views.add_argument("--references", nargs="+", metavar="VIEW", help=references)
    maps = parser.add_argument_group("depth maps, pictures with depth, layers")
    text = "disparities of the picture, or inverse depth (--near-far), never distances"
    maps.add_argument("--depth", metavar="MAP", help=text)
    scale = "disparity in pixels per unit of m of 1 in the map, or in inverse depth (--near-far); default: 1"
    maps.add_argument("--depth-scale", type=cli.parse_number, metavar="S", help=scale)
    near_far = "depths of the largest number and of 0 in maps of 8 or 16 bits that are even in inverse depth"
    maps.add_argument("--near-far", type=parse_near_far, metavar="NEAR:FAR", help=near_far)
    transform = f"whether wavelets stop at edges; default: {TRANSFORMS[0]}"
    maps.add_argument("--transform", choices=TRANSFORMS, help=transform)
    maps.add_argument("--wavelet", choices=WAVELETS, help=f"default: {WAVELETS[0]}")
    for name, planes in (("--order-depth", "maps; default: 1"), ("--order-image", "pictures; default: 0")):
        text = f"degree, 0 to 3, of the polynomials that continue signals at edges in {planes}"
        cli.add_integer(parser, name, (0, 3), text, metavar="K")
    edges = (
        "edges that are worth their bits (auto), of Canny's detector, none, or of a file of decode; "
        "default: auto"
    )
    maps.add_argument("--edges", metavar="{auto,canny,none,FILE}", help=edges)
    _add_hole_options(parser, "0 in pictures without --near-far")
    share = (
        "share of the bits for edges and depth; auto: that with the best views near a picture; "
        "default: 0.2, more if masks of layers need it"
    )
    maps.add_argument("--depth-share", type=parse_share_or_auto, metavar="S", help=share)
    keep = (
        "values of layers: those worth their bits in other views, at least the reference view with its "
        "disparities, or all; default: auto"
    )
    maps.add_argument("--keep", choices=KEEP, help=keep)
    _add_figures(parser, "show no progress and print no summary")


def _add_decode_options(parser: argparse.ArgumentParser) -> None:
    _add_stream(parser)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    _add_layers(parser)
    text = "halve both sides J times"
    cli.add_integer(parser, "--resolution", (0, 15), text, default=0, metavar="J")
    truth = "original of a stream of one map; adds PSNR"
    parser.add_argument("--truth-depth", metavar="MAP", help=f"{truth} of the map")
    parser.add_argument("--truth-image", metavar="IMAGE", help=f"{truth} of the picture")
    _add_hole_options(parser, "0 in pictures")
    _add_figures(parser, "print no summary")


def _add_render_options(parser: argparse.ArgumentParser) -> None:
    _add_stream(parser)
    viewpoints = parser.add_mutually_exclusive_group(required=True)
    view = "position on the lattice, or the number of a view of the stream"
    viewpoints.add_argument("--view", type=parse_view, metavar="M,N|K", help=view)
    path = "two or more views: render views between each and the next"
    viewpoints.add_argument("--path", dest="route", nargs="+", type=parse_view, metavar="M,N|K", help=path)
    cli.add_integer(parser, "--frames", (2, 100_000), "frames of the video", default=50)
    rate = "frames per second; default: 25"
    parser.add_argument("--frame-rate", type=cli.parse_frame_rate, default="25", metavar="F", help=rate)
    out = "picture (.png), or video (.mp4, .mkv, .y4m) with --path"
    parser.add_argument("--out", metavar="FILE", required=True, help=out)
    _add_layers(parser)
    blend = "references that see a point: their mean by distance, or the nearest; default: %(default)s"
    parser.add_argument("--blend", choices=BLENDS, default=BLENDS[0], help=blend)
    truth = "picture taken from the viewpoint; adds PSNR and SSIM"
    parser.add_argument("--truth", metavar="VIEW", help=truth)
    _add_figures(parser, "show no progress and print no summary")


def _add_view_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="SCENE", help="stream, whole or cut, or folder of layers or sprites")
    parser.add_argument("--out", metavar="PAGE.html", required=True, help="page to write")
    _add_memory(parser)
    _add_layers(parser)
    truth = (
        "pictures taken at the views of the stream, in their order, or at given positions; the page "
        "shows their PSNR"
    )
    parser.add_argument("--truth", nargs="+", default=[], metavar="[M,N=|K=]VIEW", help=truth)
    _add_figures(parser, "show no progress and print no summary")


def _add_evaluate_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("streams", nargs="+", metavar="STREAM", help="whole or cut")
    parser.add_argument("--truth-depth", metavar="MAP", help="original map of the streams")
    parser.add_argument("--truth-image", metavar="IMAGE", help="original picture of the streams")
    parser.add_argument("--out", metavar="DIR", help="folder to write curves to, new or empty")
    _add_memory(parser)
    _add_figures(parser, "print no table")


def _add_info_options(parser: argparse.ArgumentParser) -> None:
    _add_stream(parser)
    _add_figures(parser, None)


def parse_depths(text: str) -> tuple[float, float, int | None]:
    """Parse a range of depths, and a number of labels."""
    near, *rest = text.split(":")
    if len(rest) not in (1, 2):
        raise argparse.ArgumentTypeError(f"expected NEAR:FAR or NEAR:FAR:LABELS such as 2:50, got {text!r}")
    labels = cli.integer(2, array_files.MAX_LABELS)(rest[1]) if len(rest) == 2 else None
    return *parse_near_far(f"{near}:{rest[0]}"), labels


def parse_near_far(text: str) -> tuple[float, float]:
    """Parse a range of depths."""
    near, _, far = text.partition(":")
    closest = cli.parse_positive(near)
    farthest = math.inf if far == "inf" else cli.parse_positive(far)
    if closest >= farthest:
        raise argparse.ArgumentTypeError(f"expected NEAR:FAR with NEAR < FAR, got {text!r}")
    return closest, farthest


def parse_share_or_auto(text: str) -> float | str:
    """Parse a share, or `auto`."""
    if text == AUTOMATIC:
        return text
    share = cli.parse_positive(text)
    if share >= 1.0:
        raise argparse.ArgumentTypeError(f"expected a share between 0 and 1, got {text!r}")
    return share


def parse_view(text: str) -> "LatticePosition | int":
    """Parse a viewpoint."""
    if re.fullmatch(r"\d{1,3}", text):
        return int(text)
    try:
        return array_files.parse_position(text)
    except argparse.ArgumentTypeError as err:
        raise argparse.ArgumentTypeError(f"{err}, or a number of a view") from None


def parse_multiplier(text: str) -> float:
    """Parse a Lagrange multiplier."""
    from dvc.images.picture_codec import LARGEST_MULTIPLIER, SMALLEST_MULTIPLIER

    multiplier = cli.parse_positive(text)
    if not SMALLEST_MULTIPLIER <= multiplier <= LARGEST_MULTIPLIER:
        raise argparse.ArgumentTypeError(
            f"expected a lambda from {SMALLEST_MULTIPLIER:g} to {LARGEST_MULTIPLIER:g}, got {text!r}"
        )
    return multiplier


def _runner(module: str, function: str) -> Callable[[argparse.Namespace], int]:
    """Return the action of a subcommand."""

    def _run(arguments: argparse.Namespace) -> int:
        status: int = getattr(import_module(f"dvc.dibr.commands.{module}"), function)(arguments)
        return status

    return _run


SUBCOMMANDS = {
    "encode": Subcommand(
        "views, a picture with depth, a depth map, or layers to a stream",
        """\
Code one of these; the last name is that of the stream. Two or more pictures are views: the first is the
reference, coded with the disparities that predict the other views best for their bits. One picture with
--depth is coded with its map, by wavelets that stop at the contours of the map; a file without --depth is a
depth map. A folder of dvc-stereo layers or sprites is coded as pictures with disparities and masks.
docs/dibr.md describes the streams.
""",
        _add_encode_options,
        _runner("dibr_encode", "run"),
        """\
  dvc-dibr encode left.png right.png pair.dibr --disparities 0:60 --bpp 0.5
  dvc-dibr encode *.png out.dibr --views views.csv --disparities -4:12 --bpp 0.3 --quality-layers 7
  dvc-dibr encode a.png b.png c.png out.dibr --cameras cameras.json --depths 2:50 --lambda 2e-3
  dvc-dibr encode left.png scene.dibr --depth disparity.pfm --bpp 0.5
  dvc-dibr encode depth.png map.dibr --bpp 0.1 --no-holes
  dvc-dibr encode layers layers.dibr --bpp 0.5
""",
    ),
    "decode": Subcommand(
        "a stream to pictures and disparities",
        """\
Decode a stream, or its whole part: reference.png, disparity.pfm (pixels per unit of m; inverse depth for
calibrated cameras), preview-disparity.png, dibr.json. Further references are reference-1.png and so on. A
depth map gives depth.pfm (numbers of the map), edges.png, disparity.pfm, and image.png if it has a picture.
Layers and sprites give the folder of dvc-stereo layers or sprites.
""",
        _add_decode_options,
        _runner("dibr_decode", "run_decode"),
        """\
  dvc-dibr decode pair.dibr --out decoded
  dvc-dibr decode pair.dibr --out small --quality-layers 1 --resolution 2
  dvc-dibr decode map.dibr --out decoded --truth-depth disparity.pfm --json -
""",
    ),
    "render": Subcommand(
        "any view of a stream",
        "Render a view of a stream as a picture, or views along a path as a video.",
        _add_render_options,
        _runner("dibr_render", "run_render"),
        """\
  dvc-dibr render pair.dibr --view 0.5,0 --out between.png
  dvc-dibr render pair.dibr --view 1 --out right.png --truth right-original.png --json -
  dvc-dibr render array.dibr --path -1,0 0,0 0,1 --frames 60 --out flight.mp4
""",
    ),
    "view": Subcommand(
        "a page to look around in a scene",
        """\
Write one HTML page in which the viewpoint is moved by mouse, touch or keys; it needs WebGL 2 and no network.
The scene is a stream, or a folder that dvc-stereo layers or dvc-stereo sprites has written.
""",
        _add_view_options,
        _runner("dibr_render", "run_view"),
        """\
  dvc-dibr view pair.dibr --out pair.html
  dvc-dibr view pair.dibr --out pair.html --truth left.png right.png
  dvc-dibr view array.dibr --out array.html --truth 3=centre.png 0.5,0=between.png
  dvc-dibr view layers --out layers.html
""",
    ),
    "info": Subcommand(
        "header and sizes of a stream",
        "Print the header of a stream, and the sizes of its parts.",
        _add_info_options,
        _runner("dibr_decode", "run_info"),
        """\
  dvc-dibr info pair.dibr
  dvc-dibr info pair.dibr --json -
""",
    ),
    "evaluate": Subcommand(
        "rates and quality of streams",
        "Compare streams of any kind: rates, bits by part, and PSNR against originals.",
        _add_evaluate_options,
        _runner("dibr_decode", "run_evaluate"),
        """\
  dvc-dibr evaluate a.dibr b.dibr --truth-depth disparity.pfm
  dvc-dibr evaluate layers-*.dibr --truth-image left.png --out curves
""",
    ),
}
