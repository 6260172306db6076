"""Rectified views from what a command is given, with a progress bar."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dvc import cli

if TYPE_CHECKING:
    from dvc.geometry.camera_array import LatticePosition
    from dvc.stereo.rectification.rectified_array import RectifiedArray


def rectified_views(
    arguments: argparse.Namespace, positions: Sequence["LatticePosition"] | None, with_matches: bool = False
) -> "RectifiedArray":
    """Read pictures and rectify them."""
    from dvc.geometry.camera_files import AUTO
    from dvc.stereo.rectification.rectified_array import rectified_array

    # nobody knows how long cameras take to be estimated
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
