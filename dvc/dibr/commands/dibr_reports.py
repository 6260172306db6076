"""Streams as files, their rendering, and reports, for all subcommands of `dvc-dibr`."""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc import cli
from dvc.dibr import view_stream
from dvc.dibr.depth_image import depth_image_stream, piece_stream
from dvc.dibr.depth_image.depth_image_stream import DecodedDepthImage, DepthImageStream
from dvc.dibr.depth_image.depth_scale import DepthMap, default_hole, read_depth_map
from dvc.dibr.depth_image.piece_stream import DecodedPieces, LayeredStream
from dvc.dibr.depth_image.scene_pieces import render_pieces
from dvc.dibr.dibr_streams import Body, body_of
from dvc.dibr.view_rendering import Blend, DecodedViews, picture_of, render
from dvc.dibr.view_stream import Header, Stream, decode, encode_layer
from dvc.errors import BitstreamError, ConfigError
from dvc.files import read_whole
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import SynthesisedView
from dvc.geometry.viewpoints import Viewpoint
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps
from dvc.images.picture_codec import PictureHeader
from dvc.metrics import SSIM_WINDOW_PX, psnr_db, ssim
from dvc.picture_files import read_picture

AnyStream = Stream | DepthImageStream | LayeredStream
AnyDecoded = DecodedViews | DecodedPieces
SUFFIX = ".dibr"
PSNR_NAMES = {"psnr_depth_db": "depth", "psnr_image_db": "image"}
"""Names in text of qualities of a depth map and its picture."""


def print_figures(arguments: argparse.Namespace, figures: dict[str, Any], text: str) -> None:
    """Write figures as JSON and text, as the options of reports specify."""
    if arguments.json is not None:
        cli.write_json(arguments.json, figures)
    if arguments.json != "-" and not getattr(arguments, "quiet", False):
        sys.stdout.write(text)


def json_files(arguments: argparse.Namespace) -> list[str | Path]:
    """Return the file of `--json` for `dvc.cli.check_outputs`."""
    return [] if arguments.json in (None, "-") else [arguments.json]


def in_decibels(figures: dict[str, Any], names: dict[str, str]) -> list[str]:
    """Return available figures with their names in text."""
    return [f"{name} {figures[key]:.2f} dB" for key, name in names.items() if figures.get(key) is not None]


def warn(path: str, damage: str | None) -> None:
    """Report the missing part of a stream on standard error."""
    if damage is not None:
        sys.stderr.write(f"dvc-dibr: {path}: {cli.one_line(damage)}; what precedes it is decoded\n")


def check_size(path: str, shape: Sequence[int], target: Sequence[int], label: str) -> None:
    """Refuse a picture of another size than a target."""
    if tuple(shape[:2]) != tuple(target):
        sizes = [f"{size[1]}x{size[0]}" for size in (shape, target)]
        raise ConfigError(f"{path}: {sizes[0]}, but {label} is {sizes[1]}")


def viewpoint_of(viewpoints: Sequence[Viewpoint], view: LatticePosition | int) -> Viewpoint:
    """Return a parsed viewpoint."""
    if not isinstance(view, LatticePosition):
        if view >= len(viewpoints):
            raise ConfigError(f"view {view}: the stream has 0 to {len(viewpoints) - 1}")
        return viewpoints[view]
    if not isinstance(viewpoints[0], LatticePosition):
        raise ConfigError(
            f"view {view.m:g},{view.n:g}: the cameras of the stream are on no lattice; "
            f"numbers from 0 to {len(viewpoints) - 1} are accepted"
        )
    return view


@contextmanager
def naming(path: str) -> Iterator[None]:
    """Prefix errors of a stream with its file."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"{path}: {err}") from None


def read_stream(path: str, max_mib: int | None = None) -> tuple[AnyStream, int]:
    """Read a stream of any kind; return it and its size in bytes."""
    data = read_whole(path)
    with naming(path):
        modules: dict[Body, Any] = {
            Body.VIEWS: view_stream,
            Body.DEPTH_IMAGE: depth_image_stream,
            Body.PIECES: piece_stream,
        }
        return modules[body_of(data)].decode_stream(data, max_mib), len(data)


def decode_views(arguments: argparse.Namespace, stream: AnyStream, resolution: int = 0) -> AnyDecoded:
    """Decode a stream of any kind, to be rendered."""
    path, num_layers = arguments.path, arguments.quality_layers
    with naming(path):
        if isinstance(stream, Stream):
            return decode(stream, num_layers, resolution)
        if num_layers is not None:
            raise ConfigError(f"--quality-layers: {path} has none, but can be cut anywhere")
        if isinstance(stream, piece_stream.LayeredStream):
            return piece_stream.decode(stream)
        if stream.picture is None:
            raise ConfigError(f"{path}: a depth map only, without a picture to render")
        return depth_image_stream.decode(stream, resolution)


def shape_of(decoded: AnyDecoded) -> tuple[int, int]:
    """Return the size of the pictures of a decoded stream."""
    if isinstance(decoded, DecodedPieces):
        return decoded.shape
    height, width = decoded.pairs[0].disparity.shape
    return height, width


def render_view(decoded: AnyDecoded, viewpoint: Viewpoint, blend: str = "distance") -> SynthesisedView:
    """Render a view of a decoded stream of any kind."""
    if isinstance(decoded, DecodedPieces):
        assert isinstance(viewpoint, LatticePosition), "layers and sprites are rectified"
        return render_pieces(decoded.scene, viewpoint)
    return render(decoded, viewpoint, Blend(blend))


def read_truth(path: str, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a picture to compare with views."""
    truth = read_picture(path)
    check_size(path, truth.shape, shape, "the stream")
    return truth


def read_with_holes(path: str, arguments: argparse.Namespace, has_holes: bool = True) -> DepthMap:
    """Read a depth map with the number of holes of the options."""
    hole = arguments.hole
    if hole is None and has_holes and not arguments.no_holes:
        hole = default_hole(path)
    return read_depth_map(path, hole)


def view_quality(view: SynthesisedView, truth: NDArray[np.uint8]) -> dict[str, float | None]:
    """Return the quality of a rendered view, compared with a picture of that viewpoint."""
    rendered, target = luma(picture_of(view)), luma(truth)
    return {
        "psnr_db": finite_psnr(rendered.reshape(1, -1), target.reshape(1, -1)),
        "ssim": ssim(rendered, target) if min(rendered.shape) >= SSIM_WINDOW_PX else None,
        "psnr_visible_db": finite_psnr(rendered[None, view.drawn], target[None, view.drawn]),
        "psnr_filled_db": finite_psnr(rendered[None, ~view.drawn], target[None, ~view.drawn]),
    }


def depth_image_quality(
    decoded: DecodedDepthImage, truth: DepthMap | None, picture: Any = None
) -> dict[str, float | None]:
    """Return the quality of a decoded map, and of its picture."""
    entries: dict[str, float | None] = {}
    if truth is not None:
        error = np.abs(decoded.depth - truth.depth)[truth.known]
        peak, mse = float(np.ptp(truth.depth[truth.known])), float(np.mean(error**2))
        entries["psnr_depth_db"] = 10.0 * math.log10(peak**2 / mse) if mse and peak else None
        entries["largest_error_depth"] = float(error.max())
    if picture is not None and decoded.picture is not None:
        entries["psnr_image_db"] = finite_psnr(luma(decoded.picture), luma(picture))
    return entries


def finite_psnr(picture: NDArray[np.uint8], truth: NDArray[np.uint8]) -> float | None:
    """Return the PSNR; None without pixels or errors."""
    value = psnr_db(picture, truth) if picture.size else math.inf
    return value if math.isfinite(value) else None


def blue_first(picture: Any) -> Any:
    """Return a picture as `dvc.picture_files.write_png` takes it."""
    return picture if picture.ndim == 2 else picture[:, :, ::-1]


def stream_figures(stream: AnyStream, num_bytes: int) -> dict[str, Any]:
    """Return the header fields and sizes of a stream, JSON-safe."""
    if isinstance(stream, Stream):
        figures = _views_figures(stream)
    elif isinstance(stream, DepthImageStream):
        figures = depth_image_figures(stream)
    else:
        figures = layered_figures(stream)
    bpp = 8 * num_bytes / (figures["width"] * figures["height"])
    return {"stream_bytes": num_bytes, "bpp": bpp, **figures}


def _views_figures(stream: Stream) -> dict[str, Any]:
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
        "viewpoints": [_viewpoint_figures(viewpoint) for viewpoint in header.viewpoints],
    }


def _viewpoint_figures(viewpoint: Viewpoint) -> dict[str, Any]:
    if isinstance(viewpoint, LatticePosition):
        return viewpoint._asdict()
    pose = viewpoint.pose
    return {"K": viewpoint.intrinsic.tolist(), "R": pose[:, :3].tolist(), "t": pose[:, 3].tolist()}


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
