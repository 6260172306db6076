"""`dvc-dibr decode`: a stream to pictures and disparities."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from dvc import cli
from dvc.dibr import view_stream
from dvc.dibr.commands.dibr_reports import (
    PSNR_NAMES,
    blue_first,
    check_size,
    depth_image_figures,
    depth_image_quality,
    header_figures,
    in_decibels,
    json_files,
    layered_figures,
    naming,
    print_figures,
    read_stream,
    read_with_holes,
    warn,
)
from dvc.dibr.depth_image import depth_image_stream, piece_stream
from dvc.dibr.depth_image.depth_image_stream import DecodedDepthImage, DepthImageStream
from dvc.dibr.depth_image.piece_stream import LayeredStream
from dvc.dibr.depth_image.scene_pieces import write_pieces
from dvc.dibr.view_stream import Stream
from dvc.errors import ConfigError
from dvc.files import atomic_folder, check_folder
from dvc.images.edge_selection import write_edges
from dvc.index_files import write_index
from dvc.picture_files import read_picture, write_pfm, write_png
from dvc.web.drawing import colour_disparity

INDEX = "dibr.json"
_FORMAT, _VERSION = "dvc-dibr", 1


def run(arguments: argparse.Namespace) -> int:
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
            figures = _write_pieces(arguments, stream)
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


def _write_pieces(arguments: argparse.Namespace, stream: LayeredStream) -> dict[str, Any]:
    """Decode layers or sprites, write their folder, and return their figures."""
    if arguments.quality_layers is not None or arguments.resolution:
        raise ConfigError("--quality-layers and --resolution require views or a depth map")
    decoded = piece_stream.decode(stream)
    with atomic_folder(arguments.out) as folder:
        write_pieces(folder, decoded.scene)
    return layered_figures(stream) | {"num_decoded": len(decoded.scene.pieces), "damage": decoded.damage}


def _quality(arguments: argparse.Namespace, decoded: DecodedDepthImage) -> dict[str, Any]:
    """Return PSNR compared with the originals of the options."""
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
    write_pfm(folder / f"disparity{suffix}.pfm", disparity.astype(np.float32))
    preview = colour_disparity(disparity, float(disparity.min()), float(disparity.max()))
    write_png(folder / f"preview-disparity{suffix}.png", preview)
