"""Camera arrays from files and options: views, positions on the lattice, and disparities."""

import argparse
import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dvc.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition

MAX_LABELS = 4096
"""Largest number of disparities; more are a mistake of units."""
MAX_NUMBER = 1e6
"""Largest magnitude of positions and disparities."""
MIN_STEP = 1e-6
"""Smallest step between disparities; smaller ones vanish in single precision."""
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def parse_disparities(text: str) -> "DisparityLabels":
    """Read a range of disparities."""
    from dvc.geometry.camera_array import DisparityLabels

    match = re.fullmatch(rf"({_NUMBER}):({_NUMBER})(?::({_NUMBER}))?", text)
    if not match:
        raise argparse.ArgumentTypeError(f"expected MIN:MAX or MIN:MAX:STEP such as 0:60, got {text!r}")
    low, high, step = float(match[1]), float(match[2]), float(match[3] or 1.0)
    if not all(map(_is_moderate, (low, high, step))) or step <= 0.0 or high < low:
        raise argparse.ArgumentTypeError(
            f"expected MIN <= MAX and STEP > 0, none beyond {MAX_NUMBER:g}, got {text!r}"
        )
    if step < MIN_STEP:
        raise argparse.ArgumentTypeError(f"expected a step of {MIN_STEP:g} at least, got {text!r}")
    if (high - low) / step > MAX_LABELS - 1:
        raise argparse.ArgumentTypeError(f"at most {MAX_LABELS} disparities, got {text!r}")
    return DisparityLabels(low, step, math.floor((high - low) / step + 1e-9) + 1)


def parse_position(text: str) -> "LatticePosition":
    """Read the position of a camera."""
    from dvc.geometry.camera_array import LatticePosition

    match = re.fullmatch(rf"({_NUMBER}),({_NUMBER})", text)
    if not match or not all(_is_moderate(float(number)) for number in match.groups()):
        raise argparse.ArgumentTypeError(f"expected M,N such as 0,0 or -1,2, got {text!r}")
    return LatticePosition(float(match[1]), float(match[2]))


def _is_moderate(number: float) -> bool:
    return abs(number) <= MAX_NUMBER


def read_positions(path: str | Path) -> dict[str, "LatticePosition"]:
    """Read positions of cameras from a table with the columns file, m and n."""
    from dvc.geometry.camera_array import LatticePosition

    positions: dict[str, LatticePosition] = {}
    try:
        with open(path, newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                name = Path(row["file"]).name
                if name in positions:
                    raise ConfigError(f"{path}: {name} is named twice")
                positions[name] = LatticePosition(float(row["m"]), float(row["n"]))
                if not all(map(_is_moderate, positions[name])):
                    raise ConfigError(f"{path}: {name} has a position beyond {MAX_NUMBER:g}")
    except KeyError as err:
        raise ConfigError(f"{path}: expected the columns file, m and n; {err} is missing") from err
    except (ValueError, TypeError, csv.Error) as err:
        raise ConfigError(f"{path}: not a table of file, m, n") from err
    if not positions:
        raise ConfigError(f"{path}: names no view")
    return positions


def read_pictures(paths: Sequence[str | Path]) -> list["NDArray[np.uint8]"]:
    """Read the pictures of at least two cameras."""
    from dvc.picture_files import read_picture

    if len(paths) < 2:
        raise ConfigError("at least two views are needed")
    for path in paths:
        if not is_unicode(Path(path).name):
            raise ConfigError(f"{path}: the name is not of Unicode characters")
    stems = [Path(path).stem for path in paths]
    _check_distinct("name", stems, stems)
    return [read_picture(path) for path in paths]


def is_unicode(text: str) -> bool:
    """Return whether UTF-8 can encode a text; names of files may be arbitrary bytes."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def read_pictures_of_one_size(paths: Sequence[str | Path]) -> list["NDArray[np.uint8]"]:
    """Read the pictures of at least two cameras, which must have one size."""
    pictures = read_pictures(paths)
    for path, picture in zip(paths, pictures, strict=True):
        if picture.shape != pictures[0].shape:
            sizes = [f"{shape[1]}x{shape[0]}" for shape in (pictures[0].shape, picture.shape)]
            raise ConfigError(f"{path}: {sizes[1]}, but {paths[0]} is {sizes[0]}; all must have one size")
    return pictures


def _check_distinct(kind: str, values: Sequence[object], texts: Sequence[str]) -> None:
    for value, text in zip(values, texts, strict=True):
        if values.count(value) > 1:
            raise ConfigError(f"two views have the {kind} {text}")


def load_array(paths: Sequence[str | Path], positions: Sequence["LatticePosition"] | None) -> "CameraArray":
    """Read the rectified views of an array."""
    from dvc.geometry.camera_array import ArrayView, CameraArray, LatticePosition

    if positions is None:
        if len(paths) > 2:
            raise ConfigError(
                f"{len(paths)} views need --lattice, --views or --cameras; two are left and right"
            )
        positions = [LatticePosition(float(m), 0.0) for m in range(len(paths))]
    if len(positions) != len(paths):
        raise ConfigError(f"{len(paths)} views and {len(positions)} positions: one for each is needed")
    _check_distinct("position", positions, [f"{position.m:g},{position.n:g}" for position in positions])
    pictures = read_pictures_of_one_size(paths)
    stems = [Path(path).stem for path in paths]
    return CameraArray(tuple(map(ArrayView, stems, pictures, positions)))


def add_lattice_options(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the options for positions of cameras."""
    group = parser.add_mutually_exclusive_group()
    lattice = f"position of each view, in the order of the views; default: {default}"
    group.add_argument("--lattice", nargs="+", type=parse_position, metavar="M,N", help=lattice)
    group.add_argument(
        "--views", metavar="CSV", help="table with the columns file, m, n, instead of --lattice"
    )


def add_array_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for positions and disparities of rectified views."""
    add_lattice_options(parser, "two views, left and right")
    disparities = "range in pixels per unit of m; negative values are farther than the plane of focus"
    parser.add_argument("--disparities", type=parse_disparities, metavar="MIN:MAX[:STEP]", help=disparities)


def add_camera_option(parser: argparse.ArgumentParser, required: bool = False, refined: bool = True) -> None:
    """Add the options for the cameras of unrectified views."""
    text = (
        "calibration of views that are not rectified: JSON, Middlebury's calib.txt, the folder of a COLMAP "
        "model, or auto to estimate it"
    )
    parser.add_argument("--cameras", metavar="FILE|auto", required=required, help=text)
    if not refined:
        return
    keep = "use the calibration of a pair unchanged, even if matches contradict it"
    parser.add_argument("--keep-cameras", action="store_true", help=keep)


def table_files(arguments: argparse.Namespace) -> list[str | Path]:
    """Return the input files and folders of the options for cameras, for `dvc.cli.check_outputs`."""
    return [name for name in (arguments.views, arguments.cameras) if name not in (None, "auto")]


def positions_of(arguments: argparse.Namespace, paths: Sequence[str]) -> list["LatticePosition"] | None:
    """Return the positions of views from the options of `add_array_options`."""
    if arguments.views is None:
        return None if arguments.lattice is None else list(arguments.lattice)
    table = read_positions(arguments.views)
    missing = next((path for path in paths if Path(path).name not in table), None)
    if missing is not None:
        raise ConfigError(f"{arguments.views} does not name {Path(missing).name}")
    return [table[Path(path).name] for path in paths]
