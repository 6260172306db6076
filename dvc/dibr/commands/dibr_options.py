"""Shared parts of the subcommands: options, viewpoints, streams as files, rendering, and reports."""

import argparse
import math
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import array_files, cli
from dvc.dibr.dibr_streams import MAX_LAYERS, MAX_MIB
from dvc.errors import BitstreamError, ConfigError
from dvc.files import read_whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dvc.dibr.depth_image.depth_image_stream import DecodedDepthImage, DepthImageStream
    from dvc.dibr.depth_image.depth_scale import DepthMap
    from dvc.dibr.depth_image.piece_stream import DecodedPieces, LayeredStream
    from dvc.dibr.view_rendering import DecodedViews
    from dvc.dibr.view_stream import Stream
    from dvc.geometry.camera_array import LatticePosition
    from dvc.geometry.view_synthesis import SynthesisedView
    from dvc.geometry.viewpoints import Viewpoint

    AnyStream = Stream | DepthImageStream | LayeredStream
    AnyDecoded = DecodedViews | DecodedPieces

SUFFIX = ".dibr"
PSNR_NAMES = {"psnr_depth_db": "depth", "psnr_image_db": "image"}
"""Names in text of qualities of a depth map and its picture."""


def add_stream(parser: argparse.ArgumentParser) -> None:
    """Add the stream that a subcommand reads."""
    parser.add_argument("path", metavar="IN.dibr", help="stream, whole or cut")
    add_memory(parser)


def add_memory(parser: argparse.ArgumentParser) -> None:
    """Add the limit of the memory for decoding."""
    text = f"memory for decoding; default: {MAX_MIB}, and pixels in proportion to the bytes of the stream"
    cli.add_integer(parser, "--max-memory", (1, 2**20), text, metavar="MIB")


def add_layers(parser: argparse.ArgumentParser) -> None:
    """Add the number of quality layers."""
    text = "decode the first K quality layers; default: all"
    cli.add_integer(parser, "--quality-layers", (1, MAX_LAYERS), text, metavar="K")


def add_hole_options(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the number of holes in depth maps."""
    hole = f"number of holes in the map; default: {default}"
    holes = parser.add_mutually_exclusive_group()
    holes.add_argument("--hole", type=cli.parse_number, metavar="V", help=hole)
    holes.add_argument("--no-holes", action="store_true", default=None, help="all numbers are depths")


def add_figures(parser: argparse.ArgumentParser, quiet: str | None) -> None:
    """Add the options of reports."""
    text = "write the results as JSON; - for standard output instead of text"
    parser.add_argument("--json", metavar="FILE", help=text)
    if quiet is not None:
        parser.add_argument("--quiet", action="store_true", help=quiet)


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


def parse_share(text: str) -> float:
    """Parse a share."""
    share = cli.parse_positive(text)
    if share >= 1.0:
        raise argparse.ArgumentTypeError(f"expected a share between 0 and 1, got {text!r}")
    return share


def parse_view(text: str) -> "LatticePosition | int":
    """Parse a viewpoint."""
    if re.fullmatch(r"\d{1,3}", text):
        return int(text)
    try:
        return array_files.parse_position(text)
    except argparse.ArgumentTypeError as err:
        raise argparse.ArgumentTypeError(f"{err}, or a number of a view") from None


def parse_multiplier(text: str) -> float:
    """Parse a Lagrange multiplier."""
    from dvc.images.picture_codec import LARGEST_MULTIPLIER, SMALLEST_MULTIPLIER

    multiplier = cli.parse_positive(text)
    if not SMALLEST_MULTIPLIER <= multiplier <= LARGEST_MULTIPLIER:
        raise argparse.ArgumentTypeError(
            f"expected a lambda from {SMALLEST_MULTIPLIER:g} to {LARGEST_MULTIPLIER:g}, got {text!r}"
        )
    return multiplier


def viewpoint_of(viewpoints: Sequence["Viewpoint"], view: "LatticePosition | int") -> "Viewpoint":
    """Return a parsed viewpoint."""
    from dvc.geometry.camera_array import LatticePosition

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


def read_stream(path: str, max_mib: int | None = None) -> "tuple[AnyStream, int]":
    """Read a stream of any kind; return it and its size in bytes."""
    from dvc.dibr.dibr_streams import Body, body_of

    data = read_whole(path)
    with naming(path):
        modules = {
            Body.VIEWS: "dvc.dibr.view_stream",
            Body.DEPTH_IMAGE: "dvc.dibr.depth_image.depth_image_stream",
            Body.PIECES: "dvc.dibr.depth_image.piece_stream",
        }
        return import_module(modules[body_of(data)]).decode_stream(data, max_mib), len(data)


def decode_views(arguments: argparse.Namespace, stream: "AnyStream", resolution: int = 0) -> "AnyDecoded":
    """Decode a stream of any kind, to be rendered."""
    from dvc.dibr.depth_image import depth_image_stream, piece_stream
    from dvc.dibr.view_decoder import decode
    from dvc.dibr.view_stream import Stream

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


def shape_of(decoded: "AnyDecoded") -> tuple[int, int]:
    """Return the size of the pictures of a decoded stream."""
    from dvc.dibr.depth_image.piece_stream import DecodedPieces

    if isinstance(decoded, DecodedPieces):
        return decoded.shape
    height, width = decoded.pairs[0].disparity.shape
    return height, width


def render_view(decoded: "AnyDecoded", viewpoint: "Viewpoint", blend: str = "distance") -> "SynthesisedView":
    """Render a view of a decoded stream of any kind."""
    from dvc.dibr.depth_image import piece_rendering
    from dvc.dibr.depth_image.piece_stream import DecodedPieces
    from dvc.dibr.view_rendering import Blend, render

    if isinstance(decoded, DecodedPieces):
        return piece_rendering.render(decoded, viewpoint)
    return render(decoded, viewpoint, Blend(blend))


def read_truth(path: str, shape: tuple[int, int]) -> "NDArray[np.uint8]":
    """Read a picture to compare with views."""
    from dvc.picture_files import read_picture

    truth = read_picture(path)
    check_size(path, truth.shape, shape, "the stream")
    return truth


def read_with_holes(path: str, arguments: argparse.Namespace, has_holes: bool = True) -> "DepthMap":
    """Read a depth map with the number of holes of the options."""
    from dvc.dibr.depth_image.depth_scale import default_hole, read_depth_map

    hole = arguments.hole
    if hole is None and has_holes and not arguments.no_holes:
        hole = default_hole(path)
    return read_depth_map(path, hole)


def view_quality(view: "SynthesisedView", truth: "NDArray[np.uint8]") -> dict[str, float | None]:
    """Return the quality of a rendered view, compared with a picture of that viewpoint."""
    from dvc.dibr.view_rendering import picture_of
    from dvc.images.colour import luma
    from dvc.metrics import SSIM_WINDOW_PX, ssim

    rendered, target = luma(picture_of(view)), luma(truth)
    return {
        "psnr_db": finite_psnr(rendered.reshape(1, -1), target.reshape(1, -1)),
        "ssim": ssim(rendered, target) if min(rendered.shape) >= SSIM_WINDOW_PX else None,
        "psnr_visible_db": finite_psnr(rendered[None, view.drawn], target[None, view.drawn]),
        "psnr_filled_db": finite_psnr(rendered[None, ~view.drawn], target[None, ~view.drawn]),
    }


def depth_image_quality(
    decoded: "DecodedDepthImage", truth: "DepthMap | None", picture: Any = None
) -> dict[str, float | None]:
    """Return the quality of a decoded map, and of its picture."""
    import numpy as np

    from dvc.images.colour import luma

    entries: dict[str, float | None] = {}
    if truth is not None:
        error = np.abs(decoded.depth - truth.depth)[truth.known]
        peak, mse = float(np.ptp(truth.depth[truth.known])), float(np.mean(error**2))
        entries["psnr_depth_db"] = 10.0 * math.log10(peak**2 / mse) if mse and peak else None
        entries["largest_error_depth"] = float(error.max())
    if picture is not None and decoded.picture is not None:
        entries["psnr_image_db"] = finite_psnr(luma(decoded.picture), luma(picture))
    return entries


def finite_psnr(picture: "NDArray[np.uint8]", truth: "NDArray[np.uint8]") -> float | None:
    """Return the PSNR; None without pixels or errors."""
    from dvc.metrics import psnr_db

    value = psnr_db(picture, truth) if picture.size else math.inf
    return value if math.isfinite(value) else None


def blue_first(picture: Any) -> Any:
    """Return a picture as `dvc.picture_files.write_png` takes it."""
    return picture if picture.ndim == 2 else picture[:, :, ::-1]
