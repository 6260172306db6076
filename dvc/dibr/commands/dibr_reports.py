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
from dvc.dibr.depth_image.depth_image_stream import (
    DecodedDepthImage,
    DepthImageStream,
    DepthMap,
    default_hole,
    read_depth_map,
)
from dvc.dibr.depth_image.piece_stream import LayeredStream
from dvc.dibr.dibr_streams import Body, body_of
from dvc.dibr.view_stream import Stream
from dvc.errors import BitstreamError, ConfigError
from dvc.files import read_whole
from dvc.images.colour import luma
from dvc.metrics import psnr_db
from dvc.picture_files import read_picture

AnyStream = Stream | DepthImageStream | LayeredStream
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
