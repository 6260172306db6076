"""`dvc-dibr evaluate` and `info`: figures of streams of any kind, and their quality."""

import argparse
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc import cli
from dvc.dibr.commands.dibr_reports import (
    check_size,
    depth_image_quality,
    finite_psnr,
    json_files,
    naming,
    print_figures,
    read_stream,
    read_truth,
    stream_figures,
    warn,
)
from dvc.dibr.depth_image import depth_image_stream, piece_stream
from dvc.dibr.depth_image.depth_scale import default_hole, read_depth_map
from dvc.dibr.depth_image.piece_stream import LayeredStream
from dvc.dibr.depth_image.scene_pieces import render_pieces
from dvc.dibr.view_rendering import picture_of
from dvc.dibr.view_stream import Stream, decode
from dvc.errors import ConfigError
from dvc.files import atomic_folder, check_folder
from dvc.images.colour import luma
from dvc.web.gallery import Gallery, Group, Shown, Table, markdown, write_gallery
from dvc.web.plotting import Line, line_plot

PARTS = "header", "edges", "depth", "image"
DOCUMENT, VALUES, PAGE = "streams.md", "streams.json", "index.html"
_CURVES = {"psnr_image_db": "Picture", "psnr_depth_db": "Depth map"}


def run(arguments: argparse.Namespace) -> int:
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
    entries["bits"] = _bits_of_views(figures) if isinstance(stream, Stream) else figures["bits"]
    if picture is not None:
        with naming(path):
            entries["psnr_image_db"] = finite_psnr(luma(_reference_of(stream)), luma(picture))
    return entries


def _reference_of(stream: Stream | LayeredStream) -> Any:
    """Return the decoded reference view of a stream."""
    if isinstance(stream, Stream):
        return decode(stream).pairs[0].picture
    return picture_of(render_pieces(piece_stream.decode(stream).scene, depth_image_stream.ORIGIN))


def _bits_of_views(figures: dict[str, Any]) -> dict[str, int]:
    """Return the bits of a stream of views by the parts of depth maps, over all layers."""
    image = 8 * sum(layer["picture_bytes"] for layer in figures["layers"])
    depth = 8 * sum(layer["disparity_bytes"] for layer in figures["layers"])
    return {"header": 8 * figures["stream_bytes"] - image - depth, "edges": 0, "depth": depth, "image": image}


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
