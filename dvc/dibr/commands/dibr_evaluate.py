"""`dvc-dibr evaluate` and `info`: figures of streams of any kind, and their quality."""

import argparse
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.dibr_options import (
    add_figures,
    add_memory,
    add_stream,
    check_size,
    depth_image_quality,
    finite_psnr,
    json_files,
    naming,
    print_figures,
    read_stream,
    read_truth,
    warn,
)
from dvc.errors import ConfigError
from dvc.subcommands import Subcommand

if TYPE_CHECKING:
    from dvc.dibr.commands.dibr_options import AnyStream
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_stream import Header, Stream
    from dvc.geometry.viewpoints import Viewpoint
    from dvc.images.edge_maps import EdgeMaps
    from dvc.web.gallery import Table
    from dvc.web.plotting import Line

SUMMARY = "rates and quality of streams"
DESCRIPTION = "Compare streams of any kind: rates, bits by part, and PSNR against originals."
EXAMPLES = """\
  dvc-dibr evaluate a.dibr b.dibr --truth-depth disparity.pfm
  dvc-dibr evaluate layers-*.dibr --truth-image left.png --out curves
"""
PARTS = "header", "edges", "depth", "image"
DOCUMENT, VALUES, PAGE = "streams.md", "streams.json", "index.html"
_CURVES = {"psnr_image_db": "Picture", "psnr_depth_db": "Depth map"}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("streams", nargs="+", metavar="STREAM", help="whole or cut")
    parser.add_argument("--truth-depth", metavar="MAP", help="original map of the streams")
    parser.add_argument("--truth-image", metavar="IMAGE", help="original picture of the streams")
    parser.add_argument("--out", metavar="DIR", help="folder to write curves to, new or empty")
    add_memory(parser)
    add_figures(parser, "print no table")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate streams."""
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
        table = _table(entries)
        if folder is not None:
            write_curves(folder, entries, table)
    print_figures(arguments, entries, markdown(table))
    if not (truths or arguments.quiet):
        sys.stderr.write("dvc-dibr: --truth-image and --truth-depth add PSNR\n")
    return 0


def stream_quality(path: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Decode a stream; return its rate, its bits by part, and its quality."""
    from dvc.dibr.depth_image import depth_image_stream
    from dvc.dibr.depth_image.depth_scale import default_hole, read_depth_map
    from dvc.dibr.view_stream import Stream
    from dvc.images.colour import luma

    truth_depth, truth_image = arguments.truth_depth, arguments.truth_image
    stream, num_bytes = read_stream(path, arguments.max_memory)
    with naming(path):
        figures = stream_figures(stream, num_bytes)
    shape = figures["height"], figures["width"]
    entries = {"kind": figures.get("kind", "views" if isinstance(stream, Stream) else "map")}
    entries |= {name: figures[name] for name in ("stream_bytes", "bpp", "width", "height", "damage")}
    picture = None if truth_image is None else read_truth(truth_image, shape)
    if isinstance(stream, depth_image_stream.DepthImageStream):
        depth_map = None if truth_depth is None else read_depth_map(truth_depth, default_hole(truth_depth))
        if depth_map is not None:
            check_size(truth_depth, depth_map.depth.shape, shape, path)
        entries |= {"bits": figures["bits"], "edge_elements": figures["edge_elements"]}
        with naming(path):
            return entries | depth_image_quality(depth_image_stream.decode(stream), depth_map, picture)
    if truth_depth is not None:
        raise ConfigError(f"{path}: --truth-depth requires streams of one depth map")
    entries["bits"] = _bits_of_views(figures) if isinstance(stream, Stream) else figures["bits"]
    if picture is not None:
        with naming(path):
            entries["psnr_image_db"] = finite_psnr(luma(_reference_of(stream)), luma(picture))
    return entries


def _reference_of(stream: "Stream | LayeredStream") -> Any:
    """Return the decoded reference view of a stream."""
    from dvc.dibr.depth_image import piece_rendering, piece_stream
    from dvc.dibr.view_decoder import decode
    from dvc.dibr.view_rendering import picture_of
    from dvc.dibr.view_stream import Stream

    if isinstance(stream, Stream):
        return decode(stream).pairs[0].picture
    decoded = piece_stream.decode(stream)
    return picture_of(piece_rendering.render(decoded, decoded.viewpoints[0]))


def _bits_of_views(figures: dict[str, Any]) -> dict[str, int]:
    """Return the bits of a stream of views by the parts of depth maps, over all layers."""
    image = 8 * sum(layer["picture_bytes"] for layer in figures["layers"])
    depth = 8 * sum(layer["disparity_bytes"] for layer in figures["layers"])
    return {"header": 8 * figures["stream_bytes"] - image - depth, "edges": 0, "depth": depth, "image": image}


def _table(entries: dict[str, dict[str, Any]]) -> "Table":
    from dvc.web.gallery import Table

    def _decibels(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

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
    caption = "Bits by part; PSNR of maps, with their range as peak, and of luma"
    return Table("Streams", caption, head, tuple(rows))


def lines_of(entries: Mapping[str, dict[str, Any]], quality: str) -> "list[Line]":
    """Return a curve of quality by rate for each kind of stream."""
    from dvc.web.plotting import Line

    points: dict[str, list[tuple[float, float]]] = {}
    for one in entries.values():
        if one.get(quality) is not None:
            points.setdefault(one["kind"], []).append((one["bpp"], one[quality]))
    return [Line(kind, *zip(*sorted(pairs), strict=True)) for kind, pairs in points.items()]


def write_curves(folder: Path, entries: Mapping[str, dict[str, Any]], table: "Table") -> None:
    """Write curves and table as Markdown, JSON, and a page."""
    import cv2
    import numpy as np

    from dvc.web.gallery import Gallery, Group, Shown, markdown, write_gallery
    from dvc.web.plotting import line_plot

    images, groups = [], []
    for quality, title in _CURVES.items():
        lines = lines_of(entries, quality)
        if not lines:
            continue
        name = title.lower().replace(" ", "-")
        files = line_plot(lines, title, "bits per pixel", "PSNR [dB]")
        for suffix, content in files.items():
            (folder / f"{name}{suffix}").write_bytes(content)
        images.append(f"![{title}]({name}.png)\n")
        picture = cv2.imdecode(np.frombuffer(files[".png"], np.uint8), cv2.IMREAD_COLOR)
        groups.append(Group(title, (Shown(title, np.asarray(picture, np.uint8)),)))
    text = "\n".join(["# Streams\n", markdown(table), *images])
    (folder / DOCUMENT).write_text(text, encoding="utf-8", errors="replace")
    cli.write_json(folder / VALUES, dict(entries))
    if groups:
        write_gallery(folder / PAGE, Gallery("Streams", "Quality by rate.", groups, [table]))


def stream_figures(stream: "AnyStream", num_bytes: int) -> dict[str, Any]:
    """Return the header fields and sizes of a stream, JSON-safe."""
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.view_stream import Stream

    if isinstance(stream, Stream):
        figures = _views_figures(stream)
    elif isinstance(stream, DepthImageStream):
        figures = depth_image_figures(stream)
    else:
        figures = layered_figures(stream)
    bpp = 8 * num_bytes / (figures["width"] * figures["height"])
    return {"stream_bytes": num_bytes, "bpp": bpp, **figures}


def _views_figures(stream: "Stream") -> dict[str, Any]:
    from dvc.dibr.view_stream import encode_layer
    from dvc.images.picture_codec import PictureHeader

    layers = [
        {
            "bytes": len(encode_layer(layer)),
            "picture_bytes": sum(len(pair.picture) for pair in layer),
            "disparity_bytes": sum(len(pair.disparity) for pair in layer),
        }
        for layer in stream.layers
    ]
    colour = PictureHeader.from_bytes(stream.layers[0][0].picture).colour
    return {**header_figures(stream.header), "colour": colour, "layers": layers, "damage": stream.damage}


def header_figures(header: "Header") -> dict[str, Any]:
    """Return the header of a stream of views, JSON-safe."""
    height, width = header.shape
    return {
        "width": width,
        "height": height,
        "disparity": header.method,
        "labels": header.labels._asdict(),
        "references": list(header.references),
        "quality_layers": header.num_layers,
        "viewpoints": [_viewpoint_figures(viewpoint) for viewpoint in header.viewpoints],
    }


def _viewpoint_figures(viewpoint: "Viewpoint") -> dict[str, Any]:
    from dvc.geometry.camera_array import LatticePosition

    if isinstance(viewpoint, LatticePosition):
        return viewpoint._asdict()
    pose = viewpoint.pose
    return {"K": viewpoint.intrinsic.tolist(), "R": pose[:, :3].tolist(), "t": pose[:, 3].tolist()}


def depth_image_figures(stream: "DepthImageStream", edges: "EdgeMaps | None" = None) -> dict[str, Any]:
    """Return the header fields and sizes of a stream of a depth map, JSON-safe."""
    height, width = stream.shape
    scale, picture = stream.scale, stream.picture
    return {
        "width": width,
        "height": height,
        "wavelet": stream.depth.header.wavelet,
        "levels": stream.depth.header.num_levels,
        "order_depth": stream.depth.order,
        "order_image": picture.order if picture else None,
        "edge_elements": (edges or stream.decoded_edges()[0]).count(),
        "edge_code": stream.edge_code.name.lower(),
        "image": picture is not None,
        "image_edges": stream.picture_edges,
        "colour": picture is not None and picture.header.colour,
        "depth": {"lowest": scale.lowest, "highest": scale.lowest + scale.extent},
        "disparity": {"factor": scale.factor, "offset": scale.offset},
        "bits": {name: 8 * size for name, size in stream.part_bytes.items()},
        "damage": stream.damage,
    }


def layered_figures(stream: "LayeredStream") -> dict[str, Any]:
    """Return the header fields and sizes of a stream of layers or sprites, JSON-safe."""
    canvas = stream.canvas
    bits = {"header": 8 * stream.num_header_bytes, "edges": 0, "depth": 0, "image": 0}
    pieces = []
    for rectangle, piece in zip(stream.rectangles, stream.pieces, strict=False):
        entries: dict[str, Any] = rectangle._asdict()
        if piece is not None and piece.picture is not None:
            entries["bits"] = {name: 8 * size for name, size in piece.part_bytes.items()}
            bits = {name: bits[name] + size for name, size in entries["bits"].items()}
        pieces.append(entries)
    return {
        "width": canvas.frame.width,
        "height": canvas.frame.height,
        "kind": stream.kind.name.lower(),
        "num_pieces": len(stream.rectangles),
        "canvas": {"width": canvas.shape[1], "height": canvas.shape[0]},
        "frame": canvas.frame._asdict(),
        "disparities": canvas.labels._asdict(),
        "resolution": canvas.resolution,
        "reference": canvas.reference,
        "num_cameras": canvas.num_cameras,
        "calibrated": canvas.world_from_rectified is not None,
        "pieces": pieces,
        "bits": bits,
        "damage": stream.damage,
    }


def _add_info_options(parser: argparse.ArgumentParser) -> None:
    add_stream(parser)
    add_figures(parser, None)


def _run_info(arguments: argparse.Namespace) -> int:
    cli.check_outputs([arguments.path], json_files(arguments))
    stream, num_bytes = read_stream(arguments.path, arguments.max_memory)
    with naming(arguments.path):
        figures = stream_figures(stream, num_bytes)
    print_figures(arguments, figures, "".join(f"{name}: {_text(value)}\n" for name, value in figures.items()))
    return 0


def _text(value: Any) -> str:
    """Return a figure in one line; lists of objects take one more each."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(one)}" for name, one in value.items())
    if isinstance(value, list) and any(isinstance(one, dict) for one in value):
        return "".join(f"\n  {number}: {_text(one)}" for number, one in enumerate(value, 1))
    if isinstance(value, list):
        return " ".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


INFO = Subcommand(
    "header and sizes of a stream",
    "Print the header of a stream, and the sizes of its parts.",
    _add_info_options,
    _run_info,
    "  dvc-dibr info pair.dibr\n  dvc-dibr info pair.dibr --json -\n",
)
