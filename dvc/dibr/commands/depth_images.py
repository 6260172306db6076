"""What the subcommands of depth maps share: options of the codec, maps and edges as they are typed."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.dibr_options import bytes_of, in_decibels, json_files, naming_rate, tell, write_stream
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.depth_image.depth_codes import CodedEdges
    from dvc.dibr.depth_image.depth_image_decoder import DecodedDepthImage
    from dvc.dibr.depth_image.depth_image_encoder import DepthImage, EncodedDepthImage, PictureOptions
    from dvc.dibr.depth_image.depth_maps import DepthMap
    from dvc.dibr.depth_image.depth_scale import DepthScale

TRANSFORMS = "shape-adaptive", "standard"
EDGES = "auto", "canny", "none"
WAVELETS = "9/7", "5/3"
SUFFIX = ".dibr"
QUALITIES = {"psnr_depth_db": "depth", "psnr_image_db": "image"}


def add_codec_options(parser: argparse.ArgumentParser) -> None:
    """Add how a depth map is coded."""
    bpp = "bits of the whole file per pixel, at most"
    parser.add_argument("--bpp", type=cli.parse_positive, metavar="R", required=True, help=bpp)
    text = "whether wavelets stop at edges; default: %(default)s"
    parser.add_argument("--transform", choices=TRANSFORMS, default=TRANSFORMS[0], help=text)
    parser.add_argument("--wavelet", choices=WAVELETS, default=WAVELETS[0], help="default: %(default)s")
    order = "degree of the polynomials that continue the map at edges, 0 to 3"
    cli.add_integer(parser, "--order-depth", (0, 3), order, default=1, metavar="K")
    edges = (
        "edges that are worth their bits (auto), of Canny's detector, none, or of a file as decode writes "
        "it; default: auto"
    )
    parser.add_argument("--edges", default=EDGES[0], metavar="{auto,canny,none,FILE}", help=edges)
    add_hole_options(parser, "0 in pictures without --near-far")


def add_hole_options(parser: argparse.ArgumentParser, default: str) -> None:
    """Add which numbers of a map are holes."""
    hole = f"number of holes in the map; default: {default}"
    holes = parser.add_mutually_exclusive_group()
    holes.add_argument("--hole", type=cli.parse_number, metavar="V", help=hole)
    holes.add_argument("--no-holes", action="store_true", help="all numbers of the map are depths")


def add_scale_options(parser: argparse.ArgumentParser) -> None:
    """Add what the numbers of a depth map mean."""
    scale = (
        "disparity, in pixels per unit of m, of 1 in the map; with --near-far, of an inverse depth of 1; "
        "default: %(default)s"
    )
    parser.add_argument("--depth-scale", type=cli.parse_number, default=1.0, metavar="S", help=scale)
    near_far = "depths of the largest number and of 0 in maps of 8 or 16 bits, even in inverse depth"
    parser.add_argument("--near-far", type=parse_near_far, metavar="NEAR:FAR", help=near_far)


def parse_near_far(text: str) -> tuple[float, float]:
    """Read a range of depths."""
    near, _, far = text.partition(":")
    closest = cli.parse_positive(near)
    farthest = math.inf if far == "inf" else cli.parse_positive(far)
    if closest >= farthest:
        raise argparse.ArgumentTypeError(f"expected NEAR:FAR with NEAR < FAR, got {text!r}")
    return closest, farthest


def check_files(arguments: argparse.Namespace, inputs: list[str | Path]) -> None:
    """Check what is read and written before anything else."""
    if Path(arguments.out).suffix.lower() != SUFFIX:
        raise ConfigError(f"the name of the stream must end in {SUFFIX}, got {arguments.out}")
    given = [arguments.edges] if arguments.edges not in EDGES else []
    cli.check_outputs([*inputs, *given], [arguments.out, *json_files(arguments)])


def read_map(path: str, arguments: argparse.Namespace) -> tuple["DepthMap", "DepthScale"]:
    """Read a depth map as the options say."""
    from dvc.dibr.depth_image.depth_maps import scale_of

    near_far = getattr(arguments, "near_far", None)
    found = read_with_holes(path, arguments, near_far is None)
    try:
        return found, scale_of(found, getattr(arguments, "depth_scale", 1.0), near_far)
    except ConfigError as err:
        raise ConfigError(f"{path}: {err}") from None


def read_with_holes(path: str, arguments: argparse.Namespace, has_holes: bool = True) -> "DepthMap":
    """Read a depth map whose holes are those of the options."""
    from dvc.dibr.depth_image.depth_maps import default_hole, read_depth_map

    hole = arguments.hole
    if hole is None and has_holes and not arguments.no_holes:
        hole = default_hole(path)
    return read_depth_map(path, hole)


def encode(
    arguments: argparse.Namespace, image: "DepthImage", picture_options: "PictureOptions | None" = None
) -> "EncodedDepthImage":
    """Encode and write a stream."""
    from dvc.dibr.depth_image.depth_codes import NUM_STEPS, DepthOptions
    from dvc.dibr.depth_image.depth_image_encoder import encode_to_size
    from dvc.dibr.depth_image.depth_image_stream import check_map
    from dvc.images.lifting import most_levels

    shape = image.depth.shape[0], image.depth.shape[1]
    check_map(shape, image.scale)
    options = DepthOptions(
        arguments.wavelet, min(DepthOptions.num_levels, most_levels(shape)), arguments.order_depth
    )
    num_pixels = shape[0] * shape[1]
    max_bytes = bytes_of(arguments.bpp, num_pixels)
    edges = _edges(arguments, image.depth)
    is_quiet = arguments.quiet or edges is not None
    bar = cli.progress_bar("selections of edges", NUM_STEPS, is_quiet)
    with bar as advance, naming_rate(arguments.bpp, num_pixels):
        encoded = encode_to_size(image, max_bytes, edges, options, picture_options, advance)
    write_stream(arguments.out, encoded.data)
    return encoded


def _edges(arguments: argparse.Namespace, depth: Any) -> "CodedEdges | None":
    """Edges as the options want them; None: to be selected."""
    from dvc.dibr.depth_image.depth_codes import code_edges
    from dvc.images.edge_extraction import canny_edges
    from dvc.images.edge_maps import EdgeMaps
    from dvc.images.edges.files import read_edges

    if arguments.transform == TRANSFORMS[1]:
        if arguments.edges != EDGES[0]:
            raise ConfigError("--edges is for the shape-adaptive transform")
        return code_edges(EdgeMaps.none(depth.shape))
    if arguments.edges == "auto":
        return None
    kinds = {"canny": lambda: canny_edges(depth), "none": lambda: EdgeMaps.none(depth.shape)}
    return code_edges(kinds.get(arguments.edges, lambda: read_edges(arguments.edges, depth.shape))())


def figures(
    encoded: "EncodedDepthImage", decoded: "DecodedDepthImage", found: "DepthMap", picture: Any = None
) -> dict[str, Any]:
    """Return what is known of a stream that was written."""
    height, width = found.depth.shape
    bits = {name: 8 * size for name, size in encoded.part_bytes.items()}
    return {
        "stream_bytes": len(encoded.data),
        "bpp": 8 * len(encoded.data) / (width * height),
        "bits": bits,
        "edge_elements": encoded.edges.count() if encoded.edges is not None else 0,
        "depth_share": (bits["edges"] + bits["depth"]) / max(sum(bits.values()) - bits["header"], 1),
        "image_edges": encoded.stream.picture_edges,
        "width": width,
        "height": height,
        **quality(decoded, found, picture),
    }


def quality(
    decoded: "DecodedDepthImage", found: "DepthMap | None", picture: Any = None
) -> dict[str, float | None]:
    """Return how near a decoded stream is to what was coded."""
    import numpy as np

    from dvc.images.colour import luma
    from dvc.metrics import psnr_db

    entries: dict[str, float | None] = {}
    if found is not None:
        error = np.abs(decoded.depth - found.depth)[found.known]
        peak, mse = float(np.ptp(found.depth[found.known])), float(np.mean(error**2))
        entries["psnr_depth_db"] = 10.0 * math.log10(peak**2 / mse) if mse and peak else None
        entries["largest_error_depth"] = float(error.max())
    if picture is not None and decoded.picture is not None:
        value = psnr_db(luma(decoded.picture), luma(picture))
        entries["psnr_image_db"] = value if math.isfinite(value) else None
    return entries


def report(arguments: argparse.Namespace, entries: dict[str, Any]) -> None:
    """Write figures where they are wanted."""
    bits, edges = 8 * entries["stream_bytes"], entries["bits"]["edges"]
    share = f"{bits} bits, {edges} of them {entries['edge_elements']} edges"
    text = f"{arguments.out}: {entries['bpp']:.4f} bits per pixel, {share}"
    tell(arguments, entries, "; ".join([text, *in_decibels(entries, QUALITIES)]) + "\n")
