"""`dvc-dibr info`: what a stream says of itself."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.options import add_json, add_stream, json_files, read_stream

if TYPE_CHECKING:
    from dvc.dibr.stream.header import Header
    from dvc.dibr.stream.layers import Stream
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

    cli.check_outputs([arguments.path], json_files(arguments))
    stream = read_stream(arguments.path)
    num_bytes = Path(arguments.path).stat().st_size
    height, width = stream.header.shape
    figures = {
        "stream_bytes": num_bytes,
        "bpp": 8 * num_bytes / (width * height),
        **header_figures(stream.header),
        "colour": _is_coloured(stream),
        "layers": _layer_figures(stream),
        "damage": stream.damage,
    }
    if arguments.json is not None:
        cli.write_json(arguments.json, figures)
    if arguments.json != "-":
        sys.stdout.write(_text(figures))
    return 0


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
