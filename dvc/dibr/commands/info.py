"""`dvc-dibr info`: what a stream says of itself."""

import argparse
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.dibr_options import add_figures, add_stream, json_files, naming, read_stream, tell

if TYPE_CHECKING:
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_stream import Header, Stream
    from dvc.geometry.viewpoints import Viewpoint
    from dvc.images.edge_maps import EdgeMaps

SUMMARY = "what a stream says of itself"
DESCRIPTION = "Print the header of a stream and its layers, whole or damaged."
EXAMPLES = """\
  dvc-dibr info pair.dibr
  dvc-dibr info pair.dibr --json -
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    add_stream(parser)
    add_figures(parser, None)


def run(arguments: argparse.Namespace) -> int:
    """Print it."""
    cli.check_outputs([arguments.path], json_files(arguments))
    stream, num_bytes = read_stream(arguments.path, arguments.max_memory)
    with naming(arguments.path):
        figures = stream_figures(stream, num_bytes)
    tell(arguments, figures, _text(stream, figures))
    return 0


def stream_figures(stream: "Stream | DepthImageStream | LayeredStream", num_bytes: int) -> dict[str, Any]:
    """Return what a stream of any kind says, JSON-safe."""
    figures = _figures(stream)
    bpp = 8 * num_bytes / (figures["width"] * figures["height"])
    return {"stream_bytes": num_bytes, "bpp": bpp, **figures}


def _figures(stream: "Stream | DepthImageStream | LayeredStream") -> dict[str, Any]:
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.view_stream import Stream

    if isinstance(stream, Stream):
        return _views_figures(stream)
    return depth_image_figures(stream) if isinstance(stream, DepthImageStream) else layered_figures(stream)


def _text(stream: "Stream | DepthImageStream | LayeredStream", figures: dict[str, Any]) -> str:
    """The figures in words."""
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.view_stream import Stream

    if isinstance(stream, Stream):
        return _views_text(figures)
    return _depth_image_text(figures) if isinstance(stream, DepthImageStream) else _layered_text(figures)


def _views_figures(stream: "Stream") -> dict[str, Any]:
    return {
        **header_figures(stream.header),
        "colour": _is_coloured(stream),
        "layers": _layer_figures(stream),
        "damage": stream.damage,
    }


def depth_image_figures(stream: "DepthImageStream", edges: "EdgeMaps | None" = None) -> dict[str, Any]:
    """Return what a stream of a depth map says, JSON-safe."""
    from dvc.dibr.depth_image.depth_image_decoder import decode_edges
    from dvc.dibr.depth_image.depth_image_stream import part_bytes

    height, width = stream.shape
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
        "bits": {name: 8 * size for name, size in part_bytes(stream).items()},
        "damage": stream.damage,
    }


def _depth_image_text(figures: dict[str, Any]) -> str:
    colour = ("colour" if figures["colour"] else "gray") if figures["image"] else "no"
    bits, depth = figures["bits"], figures["depth"]
    sharing = "; the picture's stops at them, too" if figures["image_edges"] else ""
    lines = [
        f"{figures['width']}x{figures['height']}, depth map and {colour} picture; {figures['stream_bytes']} "
        f"bytes, {figures['bpp']:.4f} bits per pixel",
        f"numbers from {depth['lowest']:g} to {depth['highest']:g}; wavelet {figures['wavelet']}, "
        f"{figures['levels']} levels, order {figures['order_depth']} at {figures['edge_elements']} edges"
        f"{sharing}",
        "bits: " + ", ".join(f"{name} {size}" for name, size in bits.items()),
    ]
    return _ended(lines, figures["damage"])


def layered_figures(stream: "LayeredStream") -> dict[str, Any]:
    """Return what a stream of layers or sprites says, JSON-safe."""
    from dvc.dibr.depth_image.depth_image_stream import part_bytes

    canvas = stream.canvas
    bits = {"header": 8 * stream.num_header_bytes, "edges": 0, "depth": 0, "image": 0}
    pieces = []
    for rectangle, piece in zip(stream.rectangles, stream.pieces, strict=False):
        entries = rectangle._asdict()
        if piece is not None and piece.picture is not None:
            parts = part_bytes(piece)
            entries |= {"bits": {name: 8 * size for name, size in parts.items()}}
            bits = {name: bits[name] + 8 * size for name, size in parts.items()}
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


def _layered_text(figures: dict[str, Any]) -> str:
    canvas, bits = figures["canvas"], figures["bits"]
    lines = [
        f"{figures['width']}x{figures['height']} in a canvas of {canvas['width']}x{canvas['height']}; "
        f"{figures['stream_bytes']} bytes, {figures['bpp']:.4f} bits per pixel",
        f"{len(figures['pieces'])} of {figures['num_pieces']} {figures['kind']}, of {figures['num_cameras']} "
        f"views; the reference is {figures['reference']}",
        "bits: " + ", ".join(f"{name} {size}" for name, size in bits.items()),
    ]
    lines += [
        f"  {number}: {piece['width']}x{piece['height']} at {piece['left']}, {piece['top']}; "
        f"{sum(piece.get('bits', {}).values())} bits"
        for number, piece in enumerate(figures["pieces"], 1)
    ]
    return _ended(lines, figures["damage"])


def _ended(lines: list[str], damage: str | None) -> str:
    """Return a report of some lines, the last of which tells of damage."""
    return "".join(f"{line}\n" for line in (*lines, *([] if damage is None else [f"damaged: {damage}"])))


def header_figures(header: "Header") -> dict[str, Any]:
    """Return what a header says, JSON-safe."""
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


def _is_coloured(stream: "Stream") -> bool:
    from dvc.images.picture_header import PictureHeader

    return PictureHeader.from_bytes(stream.layers[0][0].picture).colour


def _layer_figures(stream: "Stream") -> list[dict[str, int]]:
    from dvc.dibr.view_stream import encode_layer

    return [
        {
            "bytes": len(encode_layer(layer)),
            "picture_bytes": sum(len(pair.picture) for pair in layer),
            "disparity_bytes": sum(len(pair.disparity) for pair in layer),
        }
        for layer in stream.layers
    ]


def _views_text(figures: dict[str, Any]) -> str:
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
    return _ended(lines, figures["damage"])
