"""`dvc-stereo rectify`: views of a planar array made of pictures of calibrated cameras."""

import argparse
import sys
from typing import TYPE_CHECKING

from dvc import array_files
from dvc.stereo.commands.views import rectified_views

if TYPE_CHECKING:
    from dvc.stereo.rectification.rectified_array import RectifiedArray

SUMMARY = "rectified views of calibrated or plain pictures"
DESCRIPTION = "Rectified views of cameras that stand in a plane."
EXAMPLES = """\
  dvc-stereo rectify *.jpg --cameras auto --out rectified
  dvc-stereo rectify a.png b.png --cameras cameras.json --out rectified
  dvc-stereo rectify *.png --cameras sparse/0 --views views.csv --out rectified
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("paths", nargs="+", metavar="VIEW", help="picture of a camera")
    array_files.add_camera_option(parser, required=True)
    array_files.add_lattice_options(parser, "found from the cameras")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Rectify."""
    from dvc.files import atomic_folder, check_folder
    from dvc.stereo.rectification.rectified_folder import write_rectified

    check_folder(arguments.out)
    positions = array_files.positions_of(arguments, arguments.paths)
    rectified = rectified_views(arguments, positions, with_matches=True)
    with atomic_folder(arguments.out) as folder:
        write_rectified(folder, rectified)
    if not arguments.quiet:
        sys.stdout.write(_summary(rectified))
    return 0


def _summary(rectified: "RectifiedArray") -> str:
    height, width = rectified.array.shape
    labels, matches = rectified.labels, rectified.matches
    lines = [
        f"{len(rectified.array)} views, {width}x{height}",
        f"off the plane of the cameras: at most {rectified.off_plane_px.max():.2f} px of parallax",
    ]
    if matches is not None and matches.rms_px is not None:
        lines.append(f"rows of {len(matches.disparities)} matches: {matches.rms_px:.2f} px rms")
    if rectified.refined:
        lines.append("the calibration was tilted and rolled to agree with them; --keep-cameras keeps it")
    if labels is not None:
        lines.append(f"disparities: {labels.lowest:g}:{labels.highest:g}:{labels.step:g}")
    return "".join(f"{line}\n" for line in lines)
