"""What several subcommands share: options, viewpoints as they are typed, streams as files."""

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import array_files, cli
from dvc.dibr.limits import MAX_LAYERS, MAX_MIB
from dvc.errors import BitstreamError, ConfigError
from dvc.files import read_whole

if TYPE_CHECKING:
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.depth_image.piece_decoder import DecodedPieces
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_rendering import DecodedViews
    from dvc.dibr.view_stream import Stream
    from dvc.geometry.camera_array import LatticePosition
    from dvc.geometry.view_synthesis import SynthesisedView
    from dvc.geometry.viewpoints import Viewpoint


def add_stream(parser: argparse.ArgumentParser) -> None:
    """Add the stream that a subcommand reads."""
    parser.add_argument("path", metavar="IN.dibr", help="stream, whole or cut")
    add_memory(parser)


def add_memory(parser: argparse.ArgumentParser) -> None:
    """Add the option that bounds what decoding takes."""
    text = (
        f"memory that decoding may take; default: {MAX_MIB}, and pixels in proportion to the stream's bytes"
    )
    cli.add_integer(parser, "--max-memory", (1, 2**20), text, metavar="MIB")


def add_layers(parser: argparse.ArgumentParser) -> None:
    """Add the option that leaves quality layers out."""
    text = "decode the first K quality layers; default: all"
    cli.add_integer(parser, "--quality-layers", (1, MAX_LAYERS), text, metavar="K")


def add_figures(parser: argparse.ArgumentParser, quiet: str | None) -> None:
    """Add the option that writes figures, and the one that has nothing printed in their place."""
    text = "write the results; - for standard output, in place of text"
    parser.add_argument("--json", metavar="FILE", help=text)
    if quiet is not None:
        parser.add_argument("--quiet", action="store_true", help=quiet)


def tell(arguments: argparse.Namespace, figures: dict[str, Any], text: str) -> None:
    """Write figures where they are wanted, and what they say in words unless that is not."""
    if arguments.json is not None:
        cli.write_json(arguments.json, figures)
    if arguments.json != "-" and not getattr(arguments, "quiet", False):
        sys.stdout.write(text)


def in_decibels(figures: dict[str, Any], names: dict[str, str]) -> list[str]:
    """Return the figures that are known, by the names that they have in text."""
    return [f"{name} {figures[key]:.2f} dB" for key, name in names.items() if figures.get(key) is not None]


def check_size(path: str, shape: Sequence[int], wanted: Sequence[int], what: str) -> None:
    """Refuse a picture of another size than it must have."""
    if tuple(shape[:2]) != tuple(wanted):
        sizes = [f"{size[1]}x{size[0]}" for size in (shape, wanted)]
        raise ConfigError(f"{path}: {sizes[0]}, but {what} is {sizes[1]}")


def write_stream(path: str, data: bytes) -> None:
    """Write a stream as a whole, or not at all."""
    from dvc.files import atomic_output

    with atomic_output(path) as temporary:
        temporary.write_bytes(data)


def bytes_of(bpp: float, num_pixels: int) -> int:
    """Return the longest file of a rate; none is longer than `MAX_BYTES`."""
    from dvc.dibr.depth_image.depth_image_stream import MAX_BYTES

    return int(min(bpp * num_pixels / 8.0, MAX_BYTES))


@contextmanager
def naming_rate(bpp: float, num_pixels: int) -> Iterator[None]:
    """Put a rate before what it is too low for."""
    try:
        yield
    except ConfigError as err:
        raise ConfigError(f"--bpp {bpp:g} of {num_pixels} pixels: {err}") from None


def parse_share(text: str) -> float:
    """Read a share."""
    share = cli.parse_positive(text)
    if share >= 1.0:
        raise argparse.ArgumentTypeError(f"expected a share between 0 and 1, got {text!r}")
    return share


def json_files(arguments: argparse.Namespace) -> list[str | Path]:
    """Return the file of `add_figures` for `dvc.cli.check_outputs`."""
    return [] if arguments.json in (None, "-") else [arguments.json]


def parse_view(text: str) -> "LatticePosition | int":
    """Read where a view is taken from."""
    if re.fullmatch(r"\d{1,3}", text):
        return int(text)
    try:
        return array_files.parse_position(text)
    except argparse.ArgumentTypeError as err:
        raise argparse.ArgumentTypeError(f"{err}, or a number of a view") from None


def parse_multiplier(text: str) -> float:
    """Read a Lagrange multiplier."""
    from dvc.images.picture_codec import LARGEST_MULTIPLIER, SMALLEST_MULTIPLIER

    multiplier = cli.parse_positive(text)
    if not SMALLEST_MULTIPLIER <= multiplier <= LARGEST_MULTIPLIER:
        raise argparse.ArgumentTypeError(
            f"expected a lambda from {SMALLEST_MULTIPLIER:g} to {LARGEST_MULTIPLIER:g}, got {text!r}"
        )
    return multiplier


def viewpoint_of(viewpoints: Sequence["Viewpoint"], view: "LatticePosition | int") -> "Viewpoint":
    """Return the viewpoint that was typed."""
    from dvc.geometry.camera_array import LatticePosition

    if not isinstance(view, LatticePosition):
        if view >= len(viewpoints):
            raise ConfigError(f"view {view}: the stream has 0 to {len(viewpoints) - 1}")
        return viewpoints[view]
    if not isinstance(viewpoints[0], LatticePosition):
        raise ConfigError(
            f"view {view.m:g},{view.n:g}: the cameras of the stream stand on no lattice; "
            f"numbers from 0 to {len(viewpoints) - 1} are accepted"
        )
    return view


@contextmanager
def naming(path: str) -> Iterator[None]:
    """Put the name of a file before what is wrong with its stream."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"{path}: {err}") from None


def read_stream(
    path: str, max_mib: int | None = None
) -> "tuple[Stream | DepthImageStream | LayeredStream, int]":
    """Read a stream of any kind, and tell how many bytes it has."""
    from dvc.dibr.dibr_streams import Body, body_of

    data = read_whole(path)
    with naming(path):
        body = body_of(data)
        room = {
            Body.VIEWS: "view_stream",
            Body.DEPTH_IMAGE: "depth_image.depth_image_stream",
            Body.PIECES: "depth_image.piece_stream",
        }[body]
        module = import_module(f"dvc.dibr.{room}")
        return module.decode_stream(data, max_mib), len(data)


def decode_views(
    arguments: argparse.Namespace,
    stream: "Stream | DepthImageStream | LayeredStream",
    resolution: int = 0,
) -> "DecodedViews | DecodedPieces":
    """Decode a stream of any kind, to be rendered."""
    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.view_decoder import decode
    from dvc.dibr.view_stream import Stream

    path, num_layers = arguments.path, arguments.quality_layers
    if isinstance(stream, Stream):
        with naming(path):
            return decode(stream, num_layers, resolution)
    if num_layers is not None:
        raise ConfigError(f"--quality-layers: {path} has none, but can be cut anywhere")
    if isinstance(stream, DepthImageStream):
        from dvc.dibr.depth_image import depth_image_decoder as depth_image

        if stream.picture is None:
            raise ConfigError(f"{path}: a depth map alone; there is no picture to render")
        with naming(path):
            return depth_image.decode(stream, resolution)
    return decode_pieces(path, stream)


def decode_pieces(path: str, stream: "LayeredStream") -> "DecodedPieces":
    """Decode a stream of layers or sprites."""
    from dvc.dibr.depth_image.piece_decoder import decode

    with naming(path):
        return decode(stream)


def render_view(
    decoded: "DecodedViews | DecodedPieces", viewpoint: "Viewpoint", blend: str = "distance"
) -> "SynthesisedView":
    """Render a view of a decoded stream of any kind."""
    from dvc.dibr.depth_image import piece_rendering as layered
    from dvc.dibr.depth_image.piece_decoder import DecodedPieces
    from dvc.dibr.view_rendering import Blend, render

    if isinstance(decoded, DecodedPieces):
        return layered.render(decoded, viewpoint)
    return render(decoded, viewpoint, Blend(blend))


def warn(path: str, damage: str | None) -> None:
    """Say on standard error what is missing of a stream."""
    if damage is not None:
        sys.stderr.write(f"dvc-dibr: {path}: {cli.one_line(damage)}; what precedes it is decoded\n")
