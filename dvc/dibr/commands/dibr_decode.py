"""`dvc-dibr decode`: a stream to pictures and disparities."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.depth_images import QUALITIES, add_hole_options
from dvc.dibr.commands.dibr_options import (
    add_figures,
    add_layers,
    add_stream,
    check_size,
    decode_pieces,
    in_decibels,
    json_files,
    naming,
    read_stream,
    tell,
    warn,
)
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.depth_image.depth_image_decoder import DecodedDepthImage
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_decoder import Decoded
    from dvc.dibr.view_stream import Stream

SUMMARY = "a stream to pictures and disparities"
DESCRIPTION = """\
Decode a stream, or as much of it as is whole: reference.png, disparity.pfm (pixels per unit of m; inverse
depth where cameras are calibrated), preview-disparity.png, dibr.json. Further references are reference-1.png
and so on. Of a depth map, or a picture with one: depth.pfm (numbers of the map), image.png, edges.png,
disparity.pfm. Of layers or sprites: the folder that dvc-stereo layers or dvc-stereo sprites would write.
"""
EXAMPLES = """\
  dvc-dibr decode pair.dibr --out decoded
  dvc-dibr decode pair.dibr --out small --quality-layers 1 --resolution 2
  dvc-dibr decode map.dibr --out decoded --truth-depth disparity.pfm --json -
"""
INDEX = "dibr.json"
_FORMAT, _VERSION = "dvc-dibr", 1


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    add_stream(parser)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    add_layers(parser)
    text = "halve both sides J times"
    cli.add_integer(parser, "--resolution", (0, 15), text, default=0, metavar="J")
    truth = "map that was coded, or picture: tells PSNR, of streams of one map"
    parser.add_argument("--truth-depth", metavar="MAP", help=truth)
    parser.add_argument("--truth-image", metavar="IMAGE", help="see there")
    add_hole_options(parser, "0 in pictures")
    add_figures(parser, "print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Decode."""
    from dvc.files import check_folder

    check_folder(arguments.out)
    truths = [path for path in (arguments.truth_depth, arguments.truth_image) if path is not None]
    cli.check_outputs([arguments.path, *truths], json_files(arguments))
    stream, _ = read_stream(arguments.path, arguments.max_memory)
    figures = _write(arguments, stream)
    warn(arguments.path, figures["damage"])
    text = f"{arguments.out}: {figures['width']}x{figures['height']}, {_told(figures)}\n"
    tell(arguments, figures, text)
    return 0


def _write(
    arguments: argparse.Namespace, stream: "Stream | DepthImageStream | LayeredStream"
) -> dict[str, Any]:
    """Decode a stream, write it, and return what is known of it."""
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.view_stream import Stream

    with naming(arguments.path):
        if isinstance(stream, DepthImageStream):
            return _depth_image(arguments, stream)
        if arguments.truth_depth is not None or arguments.truth_image is not None:
            raise ConfigError(
                "--truth-depth and --truth-image are for streams of one depth map; see render --truth"
            )
        return _views(arguments, stream) if isinstance(stream, Stream) else _layered(arguments, stream)


def _told(figures: dict[str, Any]) -> str:
    if "decoded_layers" in figures:
        return f"{figures['decoded_layers']} of {figures['quality_layers']} quality layers"
    if "kind" in figures:
        return f"{figures['num_decoded']} of {figures['num_pieces']} {figures['kind']}"
    return ", ".join([f"{figures['edge_elements']} edges", *in_decibels(figures, QUALITIES)])


def _views(arguments: argparse.Namespace, stream: "Stream") -> dict[str, Any]:
    """Decode views, write them, and return what is known of them."""
    from dvc.dibr.view_decoder import decode
    from dvc.files import atomic_folder
    from dvc.index_files import write_index
    from dvc.picture_files import write_png

    decoded = decode(stream, arguments.quality_layers, arguments.resolution)
    figures = _figures(decoded)
    with atomic_folder(arguments.out) as folder:
        for number, pair in enumerate(decoded.pairs):
            write_png(folder / f"reference{suffix_of(number)}.png", blue_first(pair.picture))
            _write_disparity(folder, suffix_of(number), pair.disparity)
        write_index(folder / INDEX, _FORMAT, _VERSION, figures)
    return figures


def _depth_image(arguments: argparse.Namespace, stream: "DepthImageStream") -> dict[str, Any]:
    """Decode a depth map, with or without its picture, write it, and return what is known of it."""
    import numpy as np

    from dvc.dibr.commands.info import depth_image_figures
    from dvc.dibr.depth_image.depth_image_decoder import decode
    from dvc.files import atomic_folder
    from dvc.images.edges.files import write_edges
    from dvc.index_files import write_index
    from dvc.picture_files import write_pfm, write_png

    if arguments.quality_layers is not None:
        raise ConfigError("--quality-layers: the stream has none, but can be cut anywhere")
    decoded = decode(stream, arguments.resolution)
    height, width = decoded.depth.shape
    figures = {
        **depth_image_figures(stream, decoded.edges),
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


def _layered(arguments: argparse.Namespace, stream: "LayeredStream") -> dict[str, Any]:
    """Decode layers or sprites, write them as the folder they came from, and return what is known of them."""
    from dvc.dibr.commands.info import layered_figures
    from dvc.dibr.depth_image.scene_pieces import write_pieces
    from dvc.files import atomic_folder

    if arguments.quality_layers is not None or arguments.resolution:
        raise ConfigError("--quality-layers and --resolution are not for layers and sprites")
    decoded = decode_pieces(arguments.path, stream)
    with atomic_folder(arguments.out) as folder:
        write_pieces(folder, decoded.scene)
    entries = {"num_decoded": len(decoded.scene.pieces), "damage": decoded.damage}
    return layered_figures(stream) | entries


def _quality(arguments: argparse.Namespace, decoded: "DecodedDepthImage") -> dict[str, Any]:
    """PSNR against what was coded, as far as it is known."""
    from dvc.dibr.commands.depth_images import quality, read_with_holes
    from dvc.picture_files import read_picture

    found = picture = None
    shape = decoded.depth.shape
    if arguments.truth_depth is not None:
        found = read_with_holes(arguments.truth_depth, arguments)
        check_size(arguments.truth_depth, found.depth.shape, shape, "what was decoded")
    if arguments.truth_image is not None:
        picture = read_picture(arguments.truth_image)
        check_size(arguments.truth_image, picture.shape, shape, "what was decoded")
        if decoded.picture is None:
            raise ConfigError("--truth-image: the stream is of a depth map alone")
    return quality(decoded, found, picture)


def suffix_of(number: int) -> str:
    """Return what the names of a reference's files end with."""
    return f"-{number}" if number else ""


def _write_disparity(folder: Path, suffix: str, disparity: Any) -> None:
    import numpy as np

    from dvc.picture_files import write_pfm, write_png
    from dvc.web.drawing import colour_disparity

    write_pfm(folder / f"disparity{suffix}.pfm", disparity.astype(np.float32))
    preview = colour_disparity(disparity, float(disparity.min()), float(disparity.max()))
    write_png(folder / f"preview-disparity{suffix}.png", preview)


def blue_first(picture: Any) -> Any:
    """Return a picture as `dvc.picture_files.write_png` takes it."""
    return picture if picture.ndim == 2 else picture[:, :, ::-1]


def _figures(decoded: "Decoded") -> dict[str, Any]:
    from dvc.dibr.commands.info import header_figures

    height, width = decoded.pairs[0].picture.shape[:2]
    return {
        **header_figures(decoded.header),
        "width": width,
        "height": height,
        "colour": decoded.pairs[0].picture.ndim == 3,
        "decoded_layers": decoded.num_layers,
        "resolution": decoded.resolution,
        "damage": decoded.damage,
        "pairs": [
            {
                "view": view,
                "reference": f"reference{suffix_of(number)}.png",
                "disparity": f"disparity{suffix_of(number)}.pfm",
            }
            for number, view in enumerate(decoded.header.references)
        ],
    }
