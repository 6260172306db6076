"""`dvc-dibr info`: what a stream says of itself."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.options import add_json, add_stream, json_files, read_stream

if TYPE_CHECKING:
    from dvc.dibr.depth_image.stream import DepthImageStream
    from dvc.dibr.stream.header import Header
    from dvc.dibr.stream.layers import Stream
    from dvc.dibr.wavelets.edge_maps import EdgeMaps
    from dvc.multiview.viewpoints import Viewpoint

SUMMARY = "what a stream says of itself"
DESCRIPTION = "Print the header of a stream and its layers, whole or damaged."
EXAMPLES = """\
  dvc-dibr info pair.dibr
  dvc-dibr info pair.dibr --json -
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Of the subcommand.
    """
    add_stream(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print it.

    Parameters
    ----------
    arguments : argparse.Namespace
        As parsed.

    Returns
    -------
    int
        Exit status.
    """
    from pathlib import Path

    from dvc.dibr.stream.layers import Stream

    cli.check_outputs([arguments.path], json_files(arguments))
    stream = read_stream(arguments.path)
    figures = stream_figures(stream, Path(arguments.path).stat().st_size)
    if arguments.json is not None:
        cli.write_json(arguments.json, figures)
    if arguments.json != "-":
        sys.stdout.write(_text(figures) if isinstance(stream, Stream) else _depth_image_text(figures))
    return 0


def stream_figures(stream: "Stream | DepthImageStream", num_bytes: int) -> dict[str, Any]:
    """Return what a stream of either kind says, JSON-safe.

    Parameters
    ----------
    stream : Stream or DepthImageStream
        The stream.
    num_bytes : int
        Of its file.

    Returns
    -------
    dict
        Length and rate, and what its kind has.
    """
    from dvc.dibr.stream.layers import Stream

    figures = _views_figures(stream) if isinstance(stream, Stream) else depth_image_figures(stream)
    bpp = 8 * num_bytes / (figures["width"] * figures["height"])
    return {"stream_bytes": num_bytes, "bpp": bpp, **figures}


def _views_figures(stream: "Stream") -> dict[str, Any]:
    return {
        **header_figures(stream.header),
        "colour": _is_coloured(stream),
        "layers": _layer_figures(stream),
        "damage": stream.damage,
    }


def depth_image_figures(stream: "DepthImageStream", edges: "EdgeMaps | None" = None) -> dict[str, Any]:
    """Return what a stream of a depth map says, JSON-safe.

    Parameters
    ----------
    stream : DepthImageStream
        The stream.
    edges : EdgeMaps, optional
        Its edges, if they are decoded already.

    Returns
    -------
    dict
        Size, transforms, bits of the parts as far as they are there, and damage.
    """
    from dvc.dibr.depth_image.decoder import decode_edges
    from dvc.dibr.depth_image.stream import header_bytes

    height, width = stream.shape
    parts = {"header": header_bytes(stream), "edges": len(stream.edges), "depth": len(stream.depth.data)}
    parts["image"] = len(stream.picture.data) if stream.picture else 0
    scale = stream.scale
    return {
        "width": width,
        "height": height,
        "wavelet": stream.depth.header.wavelet,
        "levels": stream.depth.header.num_levels,
        "order_depth": stream.depth.order,
        "order_image": stream.picture.order if stream.picture else None,
        "edge_elements": (edges or decode_edges(stream)).count(),
        "edge_code": stream.edge_code.name.lower(),
        "image": stream.picture is not None,
        "image_edges": stream.picture_edges,
        "colour": stream.picture is not None and stream.picture.header.colour,
        "depth": {"lowest": scale.lowest, "highest": scale.lowest + scale.extent},
        "disparity": {"factor": scale.factor, "offset": scale.offset},
        "bits": {name: 8 * size for name, size in parts.items()},
        "damage": stream.damage,
    }


def _depth_image_text(figures: dict[str, Any]) -> str:
    colour = ("colour" if figures["colour"] else "gray") if figures["image"] else "no"
    bits, depth = figures["bits"], figures["depth"]
    sharing = ", which stops at them, too" if figures["image_edges"] else ""
    lines = [
        f"{figures['width']}x{figures['height']}, depth map and {colour} picture; {figures['stream_bytes']} "
        f"bytes, {figures['bpp']:.4f} bits per pixel",
        f"numbers from {depth['lowest']:g} to {depth['highest']:g}; wavelet {figures['wavelet']}, "
        f"{figures['levels']} levels, order {figures['order_depth']} at {figures['edge_elements']} edges"
        f"{sharing}",
        "bits: " + ", ".join(f"{name} {size}" for name, size in bits.items()),
    ]
    lines += [] if figures["damage"] is None else [f"damaged: {figures['damage']}"]
    return "".join(f"{line}\n" for line in lines)


def header_figures(header: "Header") -> dict[str, Any]:
    """Return what a header says, JSON-safe.

    Parameters
    ----------
    header : Header
        The header.

    Returns
    -------
    dict
        Size, method, labels, references, layers and viewpoints.
    """
    height, width = header.shape
    return {
        "width": width,
        "height": height,
        "disparity": header.method.name.lower(),
        "labels": header.labels._asdict(),
        "references": list(header.references),
        "quality_layers": header.num_layers,
        "viewpoints": [_viewpoint_figures(viewpoint) for viewpoint in header.viewpoints],
    }


def _viewpoint_figures(viewpoint: "Viewpoint") -> dict[str, Any]:
    from dvc.multiview.camera_array import LatticePosition

    if isinstance(viewpoint, LatticePosition):
        return viewpoint._asdict()
    pose = viewpoint.pose
    return {"K": viewpoint.intrinsic.tolist(), "R": pose[:, :3].tolist(), "t": pose[:, 3].tolist()}


def _is_coloured(stream: "Stream") -> bool:
    from dvc.dibr.reference.codec import ReferenceHeader

    return ReferenceHeader.from_bytes(stream.layers[0][0].picture).colour


def _layer_figures(stream: "Stream") -> list[dict[str, int]]:
    from dvc.dibr.stream.layers import encode_layer

    return [
        {
            "bytes": len(encode_layer(layer)),
            "picture_bytes": sum(len(pair.picture) for pair in layer),
            "disparity_bytes": sum(len(pair.disparity) for pair in layer),
        }
        for layer in stream.layers
    ]


def _text(figures: dict[str, Any]) -> str:
    labels, viewpoints = figures["labels"], figures["viewpoints"]
    kind = "on a lattice" if "m" in viewpoints[0] else "of calibrated cameras"
    colour = "colour" if figures["colour"] else "gray"
    lines = [
        f"{figures['width']}x{figures['height']}, {colour}; {figures['stream_bytes']} bytes, "
        f"{figures['bpp']:.4f} bits per pixel",
        f"{len(viewpoints)} views {kind}; coded: {', '.join(map(str, figures['references']))}",
        f"disparities: {labels['lowest']:g} and {labels['num_labels'] - 1} steps of {labels['step']:g}, "
        f"as {figures['disparity']}",
        f"quality layers: {len(figures['layers'])} of {figures['quality_layers']} are whole",
    ]
    lines += [
        f"  {number}: {layer['bytes']} bytes, {layer['picture_bytes']} of pictures, "
        f"{layer['disparity_bytes']} of disparities"
        for number, layer in enumerate(figures["layers"], 1)
    ]
    lines += [] if figures["damage"] is None else [f"damaged: {figures['damage']}"]
    return "".join(f"{line}\n" for line in lines)
