"""`dvc-dibr decode`, `info` and `evaluate`: pictures and disparities of streams, and their figures."""

import argparse
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc import cli
from dvc.dibr import view_stream
from dvc.dibr.commands.dibr_reports import (
    PSNR_NAMES,
    AnyStream,
    blue_first,
    check_size,
    depth_image_quality,
    finite_psnr,
    in_decibels,
    json_files,
    naming,
    print_figures,
    read_stream,
    read_truth,
    read_with_holes,
    warn,
)
from dvc.dibr.depth_image import depth_image_stream, piece_stream
from dvc.dibr.depth_image.depth_image_stream import (
    DepthImageStream,
    default_hole,
    read_depth_map,
)
from dvc.dibr.depth_image.piece_stream import LayeredStream
from dvc.dibr.depth_image.scene_pieces import render_pieces, write_pieces
from dvc.dibr.view_rendering import picture_of
from dvc.dibr.view_stream import Header, Stream, encode_layer
from dvc.errors import ConfigError
from dvc.files import atomic_folder, check_folder
from dvc.geometry.camera_array import LatticePosition
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import write_edges
from dvc.images.picture_codec import PictureHeader
from dvc.index_files import write_index
from dvc.picture_files import read_picture, write_pfm, write_png
from dvc.web.drawing import colour_disparity
from dvc.web.gallery import Gallery, Group, Shown, Table, markdown, write_gallery
from dvc.web.plotting import Line, line_plot

INDEX = "dibr.json"
_FORMAT, _VERSION = "dvc-dibr", 1
PARTS = "header", "edges", "depth", "image"
DOCUMENT, VALUES, PAGE = "streams.md", "streams.json", "index.html"
_CURVES = {"psnr_image_db": "Picture", "psnr_depth_db": "Depth map"}


def run_decode(arguments: argparse.Namespace) -> int:
    """Decode."""
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
            if arguments.quality_layers is not None or arguments.resolution:
                raise ConfigError("--quality-layers and --resolution require views or a depth map")
            pieces = piece_stream.decode(stream)
            with atomic_folder(arguments.out) as folder:
                write_pieces(folder, pieces.scene)
            figures = layered_figures(stream)
            figures |= {"num_decoded": len(pieces.scene.pieces), "damage": pieces.damage}
            summary = f"{figures['num_decoded']} of {figures['num_pieces']} {figures['kind']}"
    warn(arguments.path, figures["damage"])
    print_figures(arguments, figures, f"{arguments.out}: {figures['width']}x{figures['height']}, {summary}\n")
    return 0


def _write_views(arguments: argparse.Namespace, stream: Stream) -> dict[str, Any]:
    """Decode views, write them, and return their figures."""
    decoded = view_stream.decode(stream, arguments.quality_layers, arguments.resolution)
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


def _write_depth_image(arguments: argparse.Namespace, stream: DepthImageStream) -> dict[str, Any]:
    """Decode a depth map, with or without its picture, write it, and return its figures."""
    if arguments.quality_layers is not None:
        raise ConfigError("--quality-layers: the stream has none, but can be cut anywhere")
    decoded = depth_image_stream.decode(stream, arguments.resolution)
    height, width = decoded.depth.shape
    depth_map = picture = None
    if arguments.truth_depth is not None:
        depth_map = read_with_holes(arguments.truth_depth, arguments)
        check_size(arguments.truth_depth, depth_map.depth.shape, (height, width), "the decoded map")
    if arguments.truth_image is not None:
        picture = read_picture(arguments.truth_image)
        check_size(arguments.truth_image, picture.shape, (height, width), "the decoded map")
        if decoded.picture is None:
            raise ConfigError("--truth-image: the stream has a depth map only")
    figures = depth_image_figures(stream, decoded.edges)
    figures |= {"width": width, "height": height, "resolution": decoded.resolution}
    figures |= depth_image_quality(decoded, depth_map, picture)
    with atomic_folder(arguments.out) as folder:
        write_pfm(folder / "depth.pfm", decoded.depth.astype(np.float32))
        _write_disparity(folder, "", decoded.disparity)
        write_edges(folder / "edges.png", decoded.edges)
        if decoded.picture is not None:
            write_png(folder / "image.png", blue_first(decoded.picture))
        write_index(folder / INDEX, _FORMAT, _VERSION, figures)
    return figures


def _write_disparity(folder: Path, suffix: str, disparity: Any) -> None:
    write_pfm(folder / f"disparity{suffix}.pfm", disparity.astype(np.float32))
    preview = colour_disparity(disparity, float(disparity.min()), float(disparity.max()))
    write_png(folder / f"preview-disparity{suffix}.png", preview)


def stream_figures(stream: AnyStream, num_bytes: int) -> dict[str, Any]:
    """Return the header fields and sizes of a stream, JSON-safe."""
    if isinstance(stream, Stream):
        layers = [
            {
                "bytes": len(encode_layer(layer)),
                "picture_bytes": sum(len(pair.picture) for pair in layer),
                "disparity_bytes": sum(len(pair.disparity) for pair in layer),
            }
            for layer in stream.layers
        ]
        colour = PictureHeader.from_bytes(stream.layers[0][0].picture).colour
        figures = header_figures(stream.header)
        figures |= {"colour": colour, "layers": layers, "damage": stream.damage}
    elif isinstance(stream, DepthImageStream):
        figures = depth_image_figures(stream)
    else:
        figures = layered_figures(stream)
    bpp = 8 * num_bytes / (figures["width"] * figures["height"])
    return {"stream_bytes": num_bytes, "bpp": bpp, **figures}


def header_figures(header: Header) -> dict[str, Any]:
    """Return the header of a stream of views, JSON-safe."""
    height, width = header.shape
    return {
        "width": width,
        "height": height,
        "disparity": header.method,
        "labels": header.labels._asdict(),
        "references": list(header.references),
        "quality_layers": header.num_layers,
        "viewpoints": [
            one._asdict()
            if isinstance(one, LatticePosition)
            else {"K": one.intrinsic.tolist(), "R": one.pose[:, :3].tolist(), "t": one.pose[:, 3].tolist()}
            for one in header.viewpoints
        ],
    }


def depth_image_figures(stream: DepthImageStream, edges: EdgeMaps | None = None) -> dict[str, Any]:
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


def layered_figures(stream: LayeredStream) -> dict[str, Any]:
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


def run_info(arguments: argparse.Namespace) -> int:
    """Print the header and sizes of a stream."""
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


def run_evaluate(arguments: argparse.Namespace) -> int:
    """Evaluate streams."""
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
    if isinstance(stream, Stream):
        image = 8 * sum(layer["picture_bytes"] for layer in figures["layers"])
        depth = 8 * sum(layer["disparity_bytes"] for layer in figures["layers"])
        header = 8 * num_bytes - image - depth
        entries["bits"] = {"header": header, "edges": 0, "depth": depth, "image": image}
    else:
        entries["bits"] = figures["bits"]
    if picture is not None:
        with naming(path):
            if isinstance(stream, Stream):
                reference = view_stream.decode(stream).pairs[0].picture
            else:
                view = render_pieces(piece_stream.decode(stream).scene, depth_image_stream.ORIGIN)
                reference = picture_of(view)
            entries["psnr_image_db"] = finite_psnr(luma(reference), luma(picture))
    return entries


def _table(entries: dict[str, dict[str, Any]]) -> Table:
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


def lines_of(entries: Mapping[str, dict[str, Any]], quality: str) -> list[Line]:
    """Return a curve of quality by rate for each kind of stream."""
    points: dict[str, list[tuple[float, float]]] = {}
    for one in entries.values():
        if one.get(quality) is not None:
            points.setdefault(one["kind"], []).append((one["bpp"], one[quality]))
    return [Line(kind, *zip(*sorted(pairs), strict=True)) for kind, pairs in points.items()]


def write_curves(folder: Path, entries: Mapping[str, dict[str, Any]], table: Table) -> None:
    """Write curves and table as Markdown, JSON, and a page."""
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
