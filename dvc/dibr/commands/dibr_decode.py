"""`dvc-dibr decode`: a stream to pictures and disparities."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.dibr_options import (
    PSNR_NAMES,
    add_figures,
    add_hole_options,
    add_layers,
    add_stream,
    blue_first,
    check_size,
    depth_image_quality,
    in_decibels,
    json_files,
    naming,
    print_figures,
    read_stream,
    read_with_holes,
    warn,
)
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.depth_image.depth_image_stream import DecodedDepthImage, DepthImageStream
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_stream import Stream

SUMMARY = "a stream to pictures and disparities"
DESCRIPTION = """\
Decode a stream, or its whole part: reference.png, disparity.pfm (pixels per unit of m; inverse depth for
calibrated cameras), preview-disparity.png, dibr.json. Further references are reference-1.png and so on. A
depth map gives depth.pfm (numbers of the map), edges.png, disparity.pfm, and image.png if it has a picture.
Layers and sprites give the folder of dvc-stereo layers or sprites.
"""
EXAMPLES = """\
  dvc-dibr decode pair.dibr --out decoded
  dvc-dibr decode pair.dibr --out small --quality-layers 1 --resolution 2
  dvc-dibr decode map.dibr --out decoded --truth-depth disparity.pfm --json -
"""
INDEX = "dibr.json"
_FORMAT, _VERSION = "dvc-dibr", 1


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    add_stream(parser)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    add_layers(parser)
    text = "halve both sides J times"
    cli.add_integer(parser, "--resolution", (0, 15), text, default=0, metavar="J")
    truth = "original of a stream of one map; adds PSNR"
    parser.add_argument("--truth-depth", metavar="MAP", help=f"{truth} of the map")
    parser.add_argument("--truth-image", metavar="IMAGE", help=f"{truth} of the picture")
    add_hole_options(parser, "0 in pictures")
    add_figures(parser, "print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Decode."""
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.view_stream import Stream
    from dvc.files import check_folder

    check_folder(arguments.out)
    truths = [path for path in (arguments.truth_depth, arguments.truth_image) if path is not None]
    cli.check_outputs([arguments.path, *truths], json_files(arguments))
    stream, _ = read_stream(arguments.path, arguments.max_memory)
    with naming(arguments.path):
        if isinstance(stream, DepthImageStream):
            figures = _write_depth_image(arguments, stream)
            parts = [f"{figures['edge_elements']} edges", *in_decibels(figures, PSNR_NAMES)]
            summary = ", ".join(parts)
        elif truths:
            raise ConfigError(
                "--truth-depth and --truth-image require a stream of one depth map; see render --truth"
            )
        elif isinstance(stream, Stream):
            figures = _write_views(arguments, stream)
            summary = f"{figures['decoded_layers']} of {figures['quality_layers']} quality layers"
        else:
            figures = _write_pieces(arguments, stream)
            summary = f"{figures['num_decoded']} of {figures['num_pieces']} {figures['kind']}"
    warn(arguments.path, figures["damage"])
    print_figures(arguments, figures, f"{arguments.out}: {figures['width']}x{figures['height']}, {summary}\n")
    return 0


def _write_views(arguments: argparse.Namespace, stream: "Stream") -> dict[str, Any]:
    """Decode views, write them, and return their figures."""
    from dvc.dibr.commands.dibr_evaluate import header_figures
    from dvc.dibr.view_decoder import decode
    from dvc.files import atomic_folder
    from dvc.index_files import write_index
    from dvc.picture_files import write_png

    decoded = decode(stream, arguments.quality_layers, arguments.resolution)
    height, width = decoded.pairs[0].picture.shape[:2]
    suffixes = [f"-{number}" if number else "" for number in range(len(decoded.pairs))]
    figures = {
        **header_figures(decoded.header),
        "width": width,
        "height": height,
        "colour": decoded.pairs[0].picture.ndim == 3,
        "decoded_layers": decoded.num_layers,
        "resolution": decoded.resolution,
        "damage": decoded.damage,
        "pairs": [
            {"view": view, "reference": f"reference{suffix}.png", "disparity": f"disparity{suffix}.pfm"}
            for suffix, view in zip(suffixes, decoded.header.references, strict=True)
        ],
    }
    with atomic_folder(arguments.out) as folder:
        for suffix, pair in zip(suffixes, decoded.pairs, strict=True):
            write_png(folder / f"reference{suffix}.png", blue_first(pair.picture))
            _write_disparity(folder, suffix, pair.disparity)
        write_index(folder / INDEX, _FORMAT, _VERSION, figures)
    return figures


def _write_depth_image(arguments: argparse.Namespace, stream: "DepthImageStream") -> dict[str, Any]:
    """Decode a depth map, with or without its picture, write it, and return its figures."""
    import numpy as np

    from dvc.dibr.commands.dibr_evaluate import depth_image_figures
    from dvc.dibr.depth_image.depth_image_stream import decode
    from dvc.files import atomic_folder
    from dvc.images.edge_extraction import write_edges
    from dvc.index_files import write_index
    from dvc.picture_files import write_pfm, write_png

    if arguments.quality_layers is not None:
        raise ConfigError("--quality-layers: the stream has none, but can be cut anywhere")
    decoded = decode(stream, arguments.resolution)
    height, width = decoded.depth.shape
    figures = depth_image_figures(stream, decoded.edges) | {
        "width": width,
        "height": height,
        "resolution": decoded.resolution,
        **_quality(arguments, decoded),
    }
    with atomic_folder(arguments.out) as folder:
        write_pfm(folder / "depth.pfm", decoded.depth.astype(np.float32))
        _write_disparity(folder, "", decoded.disparity)
        write_edges(folder / "edges.png", decoded.edges)
        if decoded.picture is not None:
            write_png(folder / "image.png", blue_first(decoded.picture))
        write_index(folder / INDEX, _FORMAT, _VERSION, figures)
    return figures


def _write_pieces(arguments: argparse.Namespace, stream: "LayeredStream") -> dict[str, Any]:
    """Decode layers or sprites, write their folder, and return their figures."""
    from dvc.dibr.commands.dibr_evaluate import layered_figures
    from dvc.dibr.depth_image.piece_stream import decode
    from dvc.dibr.depth_image.scene_pieces import write_pieces
    from dvc.files import atomic_folder

    if arguments.quality_layers is not None or arguments.resolution:
        raise ConfigError("--quality-layers and --resolution require views or a depth map")
    decoded = decode(stream)
    with atomic_folder(arguments.out) as folder:
        write_pieces(folder, decoded.scene)
    return layered_figures(stream) | {"num_decoded": len(decoded.scene.pieces), "damage": decoded.damage}


def _quality(arguments: argparse.Namespace, decoded: "DecodedDepthImage") -> dict[str, Any]:
    """Return PSNR compared with the originals of the options."""
    from dvc.picture_files import read_picture

    depth_map = picture = None
    shape = decoded.depth.shape
    if arguments.truth_depth is not None:
        depth_map = read_with_holes(arguments.truth_depth, arguments)
        check_size(arguments.truth_depth, depth_map.depth.shape, shape, "the decoded map")
    if arguments.truth_image is not None:
        picture = read_picture(arguments.truth_image)
        check_size(arguments.truth_image, picture.shape, shape, "the decoded map")
        if decoded.picture is None:
            raise ConfigError("--truth-image: the stream has a depth map only")
    return depth_image_quality(decoded, depth_map, picture)


def _write_disparity(folder: Path, suffix: str, disparity: Any) -> None:
    import numpy as np

    from dvc.picture_files import write_pfm, write_png
    from dvc.web.drawing import colour_disparity

    write_pfm(folder / f"disparity{suffix}.pfm", disparity.astype(np.float32))
    preview = colour_disparity(disparity, float(disparity.min()), float(disparity.max()))
    write_png(folder / f"preview-disparity{suffix}.png", preview)
