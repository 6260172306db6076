"""`dvc-dibr encode-layers`: layers or sprites to a stream."""

import argparse
import math
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.depth_images import SUFFIX, WAVELETS
from dvc.dibr.commands.dibr_options import (
    add_figures,
    bytes_of,
    in_decibels,
    json_files,
    naming_rate,
    parse_share,
    tell,
    write_stream,
)
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.depth_image.piece_encoder import EncodedPieces
    from dvc.dibr.depth_image.scene_pieces import Pieces

SUMMARY = "layers or sprites to a stream"
DESCRIPTION = """\
Code layers or sprites with depth, each as a picture with its disparities and its mask, by wavelets that stop
at the border of the mask. Views from near by show what is hidden in the reference view as well.
"""
KEEP = "auto", "all"
EXAMPLES = """\
  dvc-stereo layers surfaces --out layers
  dvc-dibr encode-layers layers layers.dibr --bpp 0.5
  dvc-dibr encode-layers sprites sprites.dibr --bpp 0.5 --depth-share 0.3
  dvc-dibr encode-layers layers layers.dibr --bpp 4 --keep all
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("folder", metavar="FOLDER", help="as dvc-stereo layers or sprites writes it")
    parser.add_argument("out", metavar="OUT.dibr", help="stream to write")
    bpp = "bits of the whole file per pixel of the reference view, at most"
    parser.add_argument("--bpp", type=cli.parse_positive, metavar="R", required=True, help=bpp)
    parser.add_argument("--wavelet", choices=WAVELETS, default=WAVELETS[0], help="default: %(default)s")
    for name, what, default in (("--order-depth", "maps", 1), ("--order-image", "pictures", 0)):
        order = f"degree of the polynomials that continue {what} at edges, 0 to 3"
        cli.add_integer(parser, name, (0, 3), order, default=default, metavar="K")
    share = "part of the bits that edges and depth have, more if masks need it; default: %(default)s"
    parser.add_argument("--depth-share", type=parse_share, default=0.2, metavar="S", help=share)
    keep = (
        "what is coded: as much as is worth its bits in other views, at least the reference view "
        "with its disparities, or all as it is; default: %(default)s"
    )
    parser.add_argument("--keep", choices=KEEP, default=KEEP[0], help=keep)
    parser.add_argument("--gray", action="store_true", help="code luma alone")
    add_figures(parser, "show no progress and print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Encode."""
    from dvc.dibr.depth_image.scene_pieces import read_pieces

    if not arguments.out.lower().endswith(SUFFIX):
        raise ConfigError(f"the name of the stream must end in {SUFFIX}, got {arguments.out}")
    cli.check_outputs(cli.with_contents([arguments.folder]), [arguments.out, *json_files(arguments)])
    scene = read_pieces(arguments.folder)
    encoded, coded = _encode(arguments, scene)
    write_stream(arguments.out, encoded.data)
    entries = figures(encoded, coded, scene)
    names = {"psnr_disparity_db": "disparity", "psnr_image_db": "colour", "psnr_views_db": "views"}
    text = (
        f"{arguments.out}: {entries['num_pieces']} {entries['kind']} of {entries['num_given']}, "
        f"{entries['bpp']:.4f} bits per pixel, "
        f"{entries['bits']['edges']} of {8 * entries['stream_bytes']} bits for masks and edges"
    )
    tell(arguments, entries, "; ".join([text, *in_decibels(entries, names)]) + "\n")
    return 0


def _encode(arguments: argparse.Namespace, scene: "Pieces") -> "tuple[EncodedPieces, Pieces]":
    """Encode, and tell what was coded of the scene."""
    from dvc.dibr.depth_image.depth_codes import DepthOptions
    from dvc.dibr.depth_image.piece_encoder import LayeredOptions, encode_to_size
    from dvc.dibr.layered.selection import MOST_TRIALS, encode_best

    frame = scene.canvas.frame
    num_pixels = frame.width * frame.height
    options = LayeredOptions(
        DepthOptions(arguments.wavelet, order=arguments.order_depth),
        arguments.order_image,
        arguments.depth_share,
        arguments.gray,
    )
    max_bytes, keeps_all = bytes_of(arguments.bpp, num_pixels), arguments.keep == KEEP[1]
    total = len(scene.pieces) if keeps_all else MOST_TRIALS
    bar = cli.progress_bar("pieces" if keeps_all else "trials", total, arguments.quiet)
    with bar as advance, naming_rate(arguments.bpp, num_pixels):
        if keeps_all:
            return encode_to_size(scene, max_bytes, options, advance), scene
        found = encode_best(scene, max_bytes, options, advance)
        return found.encoded, found.scene


def figures(encoded: "EncodedPieces", coded: "Pieces", scene: "Pieces") -> dict[str, Any]:
    """Return what is known of a stream that was written."""
    import numpy as np

    from dvc.dibr.depth_image.piece_decoder import decode
    from dvc.dibr.depth_image.piece_stream import decode_stream
    from dvc.dibr.layered.stack import luma_from, viewpoints_of

    frame = scene.canvas.frame
    found = decode(decode_stream(encoded.data)).scene
    pairs = [pair for pair in zip(found.pieces, coded.pieces, strict=True) if pair[1].mask.any()]
    colour = [np.float64(one.colour[one.mask]) - other.colour[other.mask] for one, other in pairs]
    disparity = [np.float64(one.disparity[one.mask]) - other.disparity[other.mask] for one, other in pairs]
    known = [other.disparity[other.mask] for _, other in pairs]
    extent = float(np.ptp(np.concatenate(known))) if known else 0.0
    views = [luma_from(found, viewpoint) - luma_from(scene, viewpoint) for viewpoint in viewpoints_of(scene)]
    return {
        "stream_bytes": len(encoded.data),
        "bpp": 8 * len(encoded.data) / (frame.width * frame.height),
        "kind": scene.kind.name.lower(),
        "num_pieces": len(coded.pieces),
        "num_given": len(scene.pieces),
        "num_values": coded.num_values,
        "num_values_given": scene.num_values,
        "bits": {name: 8 * size for name, size in encoded.part_bytes.items()},
        "edge_elements": encoded.edge_elements,
        "psnr_image_db": _psnr(colour, 255.0),
        "psnr_disparity_db": _psnr(disparity, extent),
        "psnr_views_db": _psnr(views, 255.0),
    }


def _psnr(errors: list[Any], peak: float) -> float | None:
    import numpy as np

    error = float(np.mean(np.concatenate(errors) ** 2)) if errors else 0.0
    return 10.0 * math.log10(peak**2 / error) if error and peak else None
