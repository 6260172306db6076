"""Subcommand `dvc-stereo evaluate`: a disparity map against the truth."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import cli
from dvc.stereo.stereo_options import add_json_option, add_truth_options, read_truth_of, write_results
from dvc.subcommands import Subcommand

if TYPE_CHECKING:
    from dvc.stereo.evaluation import Evaluation

_EXAMPLES = """\
  dvc-stereo evaluate surfaces/disparity-left.pfm --truth disp2.png --truth-scale 4 --mask nonocc.png
  dvc-stereo evaluate disparity-l.pfm --truth truth.pfm --confidence confidence-l.png
  dvc-stereo evaluate map.pfm --truth disp.png --truth-scale 1024 --truth-offset -16 --truth-unknown none
  dvc-stereo evaluate disparity.pfm --truth truth.pfm --thresholds 0.03,0.07 --json -
"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("path", metavar="MAP.pfm", help="disparity map")
    add_truth_options(parser)
    thresholds = "pixels with larger errors are bad; in pixels, default: 0.5,1,2"
    parser.add_argument(
        "--thresholds", type=parse_thresholds, default=(0.5, 1.0, 2.0), metavar="T,T", help=thresholds
    )
    add_json_option(parser)
    confidence = "8-bit picture: evaluate its order of errors, as the area under the sparsification curve"
    parser.add_argument("--confidence", metavar="PNG", help=confidence)
    parser.add_argument("--error-map", metavar="PNG", help="draw the pixels with errors above 1 px")


def parse_thresholds(text: str) -> tuple[float, ...]:
    """Read thresholds."""
    values = tuple(dict.fromkeys(cli.parse_number(part) for part in text.split(",")))
    if min(values) < 0.0:
        raise argparse.ArgumentTypeError(f"expected thresholds in pixels such as 0.5,1,2, got {text!r}")
    return values


def _run(arguments: argparse.Namespace) -> int:
    """Compare a map with the truth."""
    from dvc.picture_files import read_pfm, read_plane, write_png
    from dvc.stereo.evaluation import disparity_error, evaluate
    from dvc.web.drawing import colour_error

    outputs = [name for name in (arguments.json, arguments.error_map) if name not in (None, "-")]
    maps = [name for name in (arguments.mask, arguments.confidence) if name is not None]
    inputs = [arguments.path, arguments.truth, *maps]
    cli.check_outputs(inputs, outputs)
    disparity = read_pfm(arguments.path)
    truth, mask = read_truth_of(arguments)
    confidence = None
    if arguments.confidence is not None:
        confidence = read_plane(Path(arguments.confidence), 1, disparity.shape)
    result = evaluate(disparity, truth, mask, arguments.thresholds, confidence)
    if arguments.error_map is not None:
        write_png(Path(arguments.error_map), colour_error(*disparity_error(disparity, truth, mask)))
    write_results(arguments.json, result.to_dict(), evaluation_text(result))
    return 0


def evaluation_text(result: "Evaluation") -> str:
    """Format the figures in one line."""
    bad = ", ".join(
        f"{percent:.2f} % > {threshold:g} px" for threshold, percent in result.bad_percent.items()
    )
    orders = [
        f"; area by confidence > {threshold:g} px {area:.2f} % (ideal {ideal:.2f})"
        for threshold, (area, ideal) in result.sparsification.items()
    ]
    error = "none" if result.mean_absolute_error_px is None else f"{result.mean_absolute_error_px:.3f} px"
    return f"bad pixels: {bad}; mean absolute error {error} ({result.num_pixels} pixels)" + "".join(orders)


EVALUATE = Subcommand(
    "a disparity map against the truth",
    "Bad pixels and mean absolute error of a disparity map.",
    _add_options,
    _run,
    _EXAMPLES,
)
