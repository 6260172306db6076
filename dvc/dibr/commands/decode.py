"""`dvc-dibr decode`: a stream to pictures and disparities."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.options import add_json, add_layers, add_stream, json_files, read_stream, warn

if TYPE_CHECKING:
    from dvc.dibr.codec.decoder import Decoded, PictureAndDisparity

SUMMARY = "a stream to pictures and disparities"
DESCRIPTION = """\
Decode a stream, or as much of it as is whole: reference.png, disparity.pfm (pixels per unit of m; inverse
depth where cameras are calibrated), preview-disparity.png, dibr.json. Further references are reference-1.png
and so on.
"""
EXAMPLES = """\
  dvc-dibr decode pair.dibr --out decoded
  dvc-dibr decode pair.dibr --out small --quality-layers 1 --resolution 2
"""
INDEX = "dibr.json"
_FORMAT, _VERSION = "dvc-dibr", 1


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Of the subcommand.
    """
    add_stream(parser)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    add_layers(parser)
    text = "halve both sides J times"
    cli.add_integer(parser, "--resolution", (0, 15), text, default=0, metavar="J")
    add_json(parser)
    parser.add_argument("--quiet", action="store_true", help="print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Decode.

    Parameters
    ----------
    arguments : argparse.Namespace
        As parsed.

    Returns
    -------
    int
        Exit status.
    """
    from dvc.dibr.codec.decoder import decode
    from dvc.files import atomic_folder, check_folder
    from dvc.index_files import write_index

    check_folder(arguments.out)
    cli.check_outputs([arguments.path], json_files(arguments))
    decoded = decode(read_stream(arguments.path), arguments.quality_layers, arguments.resolution)
    figures = _figures(decoded)
    with atomic_folder(arguments.out) as folder:
        for number, pair in enumerate(decoded.pairs):
            _write_pair(folder, suffix_of(number), pair)
        write_index(folder / INDEX, _FORMAT, _VERSION, figures)
    warn(arguments.path, decoded.damage)
    if arguments.json is not None:
        cli.write_json(arguments.json, figures)
    if arguments.json != "-" and not arguments.quiet:
        layers = f"{decoded.num_layers} of {decoded.header.num_layers} quality layers"
        sys.stdout.write(f"{arguments.out}: {figures['width']}x{figures['height']}, {layers}\n")
    return 0


def suffix_of(number: int) -> str:
    """Return what the names of a reference's files end with.

    Parameters
    ----------
    number : int
        Of the reference among all references.

    Returns
    -------
    str
        Nothing for the first one, "-1" for the second.
    """
    return f"-{number}" if number else ""


def _write_pair(folder: Path, suffix: str, pair: "PictureAndDisparity") -> None:
    import numpy as np

    from dvc.page.drawing import colour_disparity
    from dvc.pfm import write_pfm
    from dvc.picture_files import write_png

    write_png(folder / f"reference{suffix}.png", blue_first(pair.picture))
    write_pfm(folder / f"disparity{suffix}.pfm", pair.disparity.astype(np.float32))
    preview = colour_disparity(pair.disparity, float(pair.disparity.min()), float(pair.disparity.max()))
    write_png(folder / f"preview-disparity{suffix}.png", preview)


def blue_first(picture: Any) -> Any:
    """Return a picture as `dvc.picture_files.write_png` takes it.

    Parameters
    ----------
    picture : ndarray of shape (H, W) or (H, W, 3), uint8
        Gray, or red, green and blue.

    Returns
    -------
    ndarray of the same shape, uint8
        Gray, or blue, green and red.
    """
    return picture if picture.ndim == 2 else picture[:, :, ::-1]


def _figures(decoded: "Decoded") -> dict[str, Any]:
    from dvc.dibr.commands.info import header_figures

    height, width = decoded.pairs[0].picture.shape[:2]
    return {
        **header_figures(decoded.header),
        "width": width,
        "height": height,
        "colour": decoded.pairs[0].picture.ndim == 3,
        "decoded_layers": decoded.num_layers,
        "resolution": decoded.resolution,
        "damage": decoded.damage,
        "pairs": [
            {
                "view": view,
                "reference": f"reference{suffix_of(number)}.png",
                "disparity": f"disparity{suffix_of(number)}.pfm",
            }
            for number, view in enumerate(decoded.header.references)
        ],
    }
