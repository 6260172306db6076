"""Options and inputs that several subcommands share: truth, meshes, outputs, rectified views."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dvc.geometry.camera_array import LatticePosition
    from dvc.stereo.rectification.rectified_array import RectifiedArray


def add_truth_options(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add the options for the truth."""
    parser.add_argument(
        "--truth", metavar="MAP", required=required, help="8-bit or 16-bit picture, or PFM file"
    )
    scale = "disparity = value / S + offset; needed for pictures, 1 for PFM files"
    parser.add_argument("--truth-scale", type=cli.parse_number, metavar="S", help=scale)
    offset = "added after the division; default: 0"
    parser.add_argument("--truth-offset", type=cli.parse_number, default=0.0, metavar="O", help=offset)
    unknown = "value that means unknown, or none; default: 0"
    parser.add_argument("--truth-unknown", type=_parse_unknown, default=0.0, metavar="V", help=unknown)
    parser.add_argument("--mask", metavar="PNG", help="only pixels of value 255 count")


def read_truth_of(arguments: argparse.Namespace) -> tuple["NDArray[np.float64]", "NDArray[np.bool_] | None"]:
    """Read the truth and the mask from the options of `add_truth_options`."""
    from dvc.stereo.evaluation import read_mask, read_truth

    truth = read_truth(
        arguments.truth, arguments.truth_scale, arguments.truth_offset, arguments.truth_unknown
    )
    return truth, None if arguments.mask is None else read_mask(arguments.mask)


def add_output_options(parser: argparse.ArgumentParser, *, figures: bool = True) -> None:
    """Add the options for a folder, for figures and meshes, and `--quiet`."""
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    if figures:
        add_json_option(parser)
        mesh = "mesh for other programs; needs the extra dvc3d[mesh]"
        parser.add_argument("--ply", metavar="FILE", help=mesh)
        parser.add_argument("--glb", metavar="FILE", help="the same for the web and for viewers")
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no summary")


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--json`."""
    text = "write the results; - for standard output, instead of text"
    parser.add_argument("--json", metavar="FILE", help=text)


def write_results(json: str | None, results: dict[str, Any], text: str) -> None:
    """Write results as `--json` asks, and a text, if any, unless JSON is on standard output."""
    if json is not None:
        cli.write_json(json, results)
    if json != "-" and text:
        sys.stdout.write(text + "\n")


def check_export(arguments: argparse.Namespace) -> list[Path]:
    """Return the mesh files of the options; refuse wrong names before any work is done."""
    paths = [(Path(name), f".{kind}") for kind in ("ply", "glb") if (name := getattr(arguments, kind))]
    for path, ending in paths:
        if path.suffix.lower() != ending:
            raise ConfigError(f"expected a name that ends in {ending}, got {path}")
    if paths:
        from dvc.stereo.meshes import trimesh_module

        trimesh_module()
    return [path for path, _ in paths]


def check_outputs(arguments: argparse.Namespace, inputs: Sequence[str | Path]) -> list[Path]:
    """Refuse folders and files that cannot be written, before any work is done."""
    from dvc.files import check_folder

    check_folder(arguments.out)
    meshes = check_export(arguments)
    named = [] if arguments.json in (None, "-") else [arguments.json]
    cli.check_outputs(cli.with_contents(inputs), [*meshes, *named])
    return meshes


def rectified_views(
    arguments: argparse.Namespace, positions: Sequence["LatticePosition"] | None, with_matches: bool = False
) -> "RectifiedArray":
    """Read pictures and rectify them."""
    from dvc.geometry.camera_files import AUTO
    from dvc.stereo.rectification.rectified_array import rectified_array

    # the duration of an estimation of cameras is unknown
    label, total = ("cameras, views", None) if arguments.cameras == AUTO else ("views", len(arguments.paths))
    with cli.progress_bar(label, total, arguments.quiet) as advance:
        return rectified_array(
            arguments.paths,
            arguments.cameras,
            positions,
            with_matches=with_matches,
            keep_cameras=arguments.keep_cameras,
            advance=advance,
        )


def _parse_unknown(text: str) -> float | None:
    return None if text == "none" else cli.parse_number(text)
