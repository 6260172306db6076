"""`dvc-dibr evaluate`: rates, bits by part, and quality of streams of any kind."""

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.dibr_options import (
    add_figures,
    add_memory,
    check_size,
    json_files,
    naming,
    read_stream,
    render_view,
    tell,
    warn,
)
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_stream import Stream
    from dvc.web.gallery import Table

SUMMARY = "streams beside each other"
DESCRIPTION = "Tell rates, bits by part, and PSNR against the truth, of streams of any kind."
EXAMPLES = """\
  dvc-dibr evaluate a.dibr b.dibr --truth-depth disparity.pfm
  dvc-dibr evaluate layers-*.dibr --truth-image left.png --out curves
"""
PARTS = "header", "edges", "depth", "image"
_NOTHING = "-"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("streams", nargs="+", metavar="STREAM", help="whole or cut")
    parser.add_argument("--truth-depth", metavar="MAP", help="map of the streams")
    parser.add_argument("--truth-image", metavar="IMAGE", help="picture of the streams")
    parser.add_argument("--out", metavar="DIR", help="folder to write curves to, new or empty")
    add_memory(parser)
    add_figures(parser, "print no table")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate streams."""
    from dvc.dibr.commands.stream_curves import write_page
    from dvc.files import atomic_folder, check_folder
    from dvc.web.gallery import markdown

    truths = [path for path in (arguments.truth_depth, arguments.truth_image) if path is not None]
    cli.check_outputs([*arguments.streams, *truths], json_files(arguments))
    if arguments.out is not None:
        check_folder(arguments.out)
    with ExitStack() as stack:
        folder = None if arguments.out is None else stack.enter_context(atomic_folder(arguments.out))
        entries = {}
        for path in arguments.streams:
            entries[path] = stream_quality(path, arguments)
            warn(path, entries[path]["damage"])
        if folder is not None:
            write_page(folder, entries, _table(entries))
    tell(arguments, entries, markdown(_table(entries)))
    if not (truths or arguments.quiet):
        sys.stderr.write("dvc-dibr: --truth-image and --truth-depth tell PSNR\n")
    return 0


def stream_quality(path: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Decode a stream and tell what it takes and how good it is."""
    from dvc.dibr.commands.depth_images import quality
    from dvc.dibr.commands.dibr_render import read_truth
    from dvc.dibr.commands.info import stream_figures
    from dvc.dibr.depth_image import depth_image_decoder as decoder
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.depth_image.depth_maps import read_truth as read_true_depth
    from dvc.dibr.view_stream import Stream
    from dvc.images.colour import luma
    from dvc.metrics import psnr_db

    truth_depth, truth_image = arguments.truth_depth, arguments.truth_image
    stream, num_bytes = read_stream(path, arguments.max_memory)
    with naming(path):
        figures = stream_figures(stream, num_bytes)
    shape = figures["height"], figures["width"]
    entries = {"kind": figures.get("kind", "views" if isinstance(stream, Stream) else "map")}
    entries |= {name: figures[name] for name in ("stream_bytes", "bpp", "width", "height", "damage")}
    picture = None if truth_image is None else read_truth(truth_image, shape)
    if not isinstance(stream, DepthImageStream):
        if truth_depth is not None:
            raise ConfigError(f"{path}: --truth-depth is for streams of one depth map")
        is_of_views = isinstance(stream, Stream)
        entries["bits"] = _bits_of_views(figures) if is_of_views else figures["bits"]
        if picture is not None:
            with naming(path):
                found = psnr_db(luma(_reference_of(stream)), luma(picture))
            entries["psnr_image_db"] = found if found < float("inf") else None
        return entries
    depth = None if truth_depth is None else read_true_depth(truth_depth)
    if depth is not None:
        check_size(truth_depth, depth.depth.shape, shape, path)
    entries |= {"bits": figures["bits"], "edge_elements": figures["edge_elements"]}
    with naming(path):
        decoded = decoder.decode(stream)
    return entries | quality(decoded, depth, picture)


def _reference_of(stream: "Stream | LayeredStream") -> Any:
    """The reference view of a stream."""
    from dvc.dibr.depth_image import piece_decoder as layered
    from dvc.dibr.view_decoder import decode
    from dvc.dibr.view_rendering import picture_of
    from dvc.dibr.view_stream import Stream

    if isinstance(stream, Stream):
        return decode(stream).pairs[0].picture
    decoded = layered.decode(stream)
    return picture_of(render_view(decoded, decoded.viewpoints[0]))


def _bits_of_views(figures: dict[str, Any]) -> dict[str, int]:
    """Bits of a stream of views, with the names that streams of one map have; layers add up."""
    image = 8 * sum(layer["picture_bytes"] for layer in figures["layers"])
    depth = 8 * sum(layer["disparity_bytes"] for layer in figures["layers"])
    return {"header": 8 * figures["stream_bytes"] - image - depth, "edges": 0, "depth": depth, "image": image}


def _table(entries: dict[str, dict[str, Any]]) -> "Table":
    from dvc.web.gallery import Table

    head = ("stream", "bytes", "bpp", *(f"{part} [bits]" for part in PARTS), "depth [dB]", "image [dB]")
    rows = [
        (
            Path(path).name,
            str(one["stream_bytes"]),
            f"{one['bpp']:.4f}",
            *(str(one["bits"][part]) for part in PARTS),
            _decibels(one.get("psnr_depth_db")),
            _decibels(one.get("psnr_image_db")),
        )
        for path, one in entries.items()
    ]
    caption = "Bits by part as far as they are there; PSNR of maps, with their range as peak, and of luma"
    return Table("Streams", caption, head, tuple(rows))


def _decibels(value: float | None) -> str:
    return _NOTHING if value is None else f"{value:.2f}"
