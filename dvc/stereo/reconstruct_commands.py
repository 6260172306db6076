"""Subcommands `dvc-stereo rectify` and `dvc-stereo reconstruct`."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import array_files, cli
from dvc.errors import ConfigError
from dvc.stereo.stereo_options import (
    add_output_options,
    add_truth_options,
    check_outputs,
    read_truth_of,
    rectified_views,
    write_results,
)
from dvc.stereo.surfaces.stereo_settings import COST_NAMES, INFERENCE_NAMES, OCCLUSION_NAMES, StereoSettings
from dvc.subcommands import Subcommand

if TYPE_CHECKING:
    from dvc.geometry.camera_array import CameraArray, DisparityLabels, Reconstruction
    from dvc.stereo.rectification.rectified_array import RectifiedArray
    from dvc.stereo.rectification.rectified_folder import RectifiedViews
    from dvc.stereo.rectification.rectified_space import Rectification
    from dvc.stereo.surface_report import Truth

_RECTIFY_EXAMPLES = """\
  dvc-stereo rectify *.jpg --cameras auto --out rectified
  dvc-stereo rectify a.png b.png --cameras cameras.json --out rectified
  dvc-stereo rectify *.png --cameras sparse/0 --views views.csv --out rectified
"""
_RECONSTRUCT_EXAMPLES = """\
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo reconstruct a.png b.png c.png --lattice -1,0 0,0 1,0 --disparities -4:12:0.5 --out surfaces
  dvc-stereo reconstruct *.png --views views.csv --disparities 0:16 --out surfaces --ply surfaces.ply
  dvc-stereo reconstruct im2.png im6.png --disparities 0:60 --truth disp2.png --truth-scale 4 --out teddy
  dvc-stereo reconstruct *.jpg --cameras auto --out surfaces
  dvc-stereo reconstruct rectified --out surfaces
"""


def _add_rectify_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dvc-stereo rectify`."""
    parser.add_argument("paths", nargs="+", metavar="VIEW", help="picture of a camera")
    array_files.add_camera_option(parser, required=True)
    array_files.add_lattice_options(parser, "found from the cameras")
    add_output_options(parser, figures=False)


def _rectify(arguments: argparse.Namespace) -> int:
    """Write the rectified views of pictures."""
    from dvc.files import atomic_folder, check_folder
    from dvc.stereo.rectification.rectified_folder import write_rectified

    check_folder(arguments.out)
    positions = array_files.positions_of(arguments, arguments.paths)
    rectified = rectified_views(arguments, positions, with_matches=True)
    with atomic_folder(arguments.out) as folder:
        write_rectified(folder, rectified)
    if not arguments.quiet:
        sys.stdout.write(_rectification_text(rectified))
    return 0


def _rectification_text(rectified: "RectifiedArray") -> str:
    height, width = rectified.array.shape
    labels, matches = rectified.labels, rectified.matches
    lines = [
        f"{len(rectified.array)} views, {width}x{height}",
        f"off the plane of the cameras: at most {rectified.off_plane_px.max():.2f} px of parallax",
    ]
    if matches is not None and matches.rms_px is not None:
        lines.append(f"rows of {len(matches.disparities)} matches: {matches.rms_px:.2f} px rms")
    if rectified.refined:
        lines.append("the calibration was tilted and rolled to agree with them; --keep-cameras prevents it")
    if labels is not None:
        lines.append(f"disparities: {labels.lowest:g}:{labels.highest:g}:{labels.step:g}")
    return "".join(f"{line}\n" for line in lines)


def _add_reconstruct_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dvc-stereo reconstruct`."""
    views = "picture of a camera; or the folder of `dvc-stereo rectify`"
    parser.add_argument("paths", nargs="+", metavar="VIEW", help=views)
    array_files.add_array_options(parser)
    array_files.add_camera_option(parser)
    add_truth_options(parser, required=False)
    add_output_options(parser)
    group = parser.add_argument_group("method")
    cost = "census: robust, summed over regions of one colour; squared: single pixels; default: census"
    group.add_argument("--cost", choices=COST_NAMES, default="census", help=cost)
    group.add_argument(
        "--inference",
        choices=INFERENCE_NAMES,
        default=StereoSettings.inference,
        help="messages between neighbours, or only scanlines, which is faster; default: %(default)s",
    )
    group.add_argument(
        "--occlusion",
        choices=OCCLUSION_NAMES,
        default=OCCLUSION_NAMES[0],
        help="visibility from surfaces, the better one of opposite views, or none; default: %(default)s",
    )
    cli.add_integer(
        group,
        "--iterations",
        (1, 20),
        "largest number of iterations; large views begin with their smallest size, for which this counts, and"
        " take two more for each larger one",
        default=3,
    )
    group.add_argument("--sub-pixel", action="store_true", help="disparities between those of --disparities")
    cli.add_integer(group, "--jobs", (1, 256), "threads; the result is the same", default=1)


def _reconstruct(arguments: argparse.Namespace) -> int:
    """Write the surfaces of all views."""
    from dvc.files import atomic_folder
    from dvc.stereo.rectification.rectified_array import check_disparities
    from dvc.stereo.surface_report import check_views, reported, summary, write_previews
    from dvc.stereo.surfaces.reconstruct import most_steps, reconstruct
    from dvc.stereo.surfaces.surface_folder import write_reconstruction

    maps = [name for name in (arguments.truth, arguments.mask) if name is not None]
    shapes = check_outputs(arguments, [*arguments.paths, *array_files.table_files(arguments), *maps])
    array, labels, rectified = _views(arguments)
    truth = _truth(arguments, array)
    warnings = check_views(array, labels)
    if rectified is None and arguments.disparities is not None:
        check_disparities(array, labels, arguments.jobs)
    settings = StereoSettings(
        cost=arguments.cost,
        inference=arguments.inference,
        occlusion=arguments.occlusion,
        max_iterations=arguments.iterations,
        sub_pixel=arguments.sub_pixel,
    )
    with atomic_folder(arguments.out) as folder:
        total = most_steps(array, labels, settings)
        with cli.progress_bar("surfaces", total, arguments.quiet) as advance:
            result = reconstruct(array, labels, settings, jobs=arguments.jobs, advance=advance)
        result = reported(result, truth, warnings)
        if rectified is not None:
            from dvc.stereo.rectification.rectified_folder import write_original_views

            result.figures["rectification"] = rectified.index
            write_original_views(folder, result, rectified.rectification)
        write_reconstruction(folder, result, arguments.jobs)
        write_previews(folder, result, truth, arguments.jobs)
    _write_shapes(shapes, result, None if rectified is None else rectified.rectification)
    for warning in result.figures["warnings"]:
        sys.stderr.write(f"dvc-stereo: {cli.one_line(warning)}\n")
    text = f"{summary(result)}\n{arguments.out}: {Path(arguments.out) / 'index.html'} shows it"
    write_results(arguments.json, result.figures, "" if arguments.quiet else text)
    return 0


def _views(arguments: argparse.Namespace) -> tuple["CameraArray", "DisparityLabels", "RectifiedViews | None"]:
    """Read the views, rectify them if cameras are given, and find disparities if none are given."""
    from dvc.stereo.rectification.rectified_array import labels_of_matches

    rectified = _rectified(arguments)
    if rectified is None:
        array = array_files.load_array(arguments.paths, array_files.positions_of(arguments, arguments.paths))
        labels = arguments.disparities or labels_of_matches(array)
    else:
        array, labels = rectified.array, arguments.disparities or rectified.labels
    if labels is None:
        raise ConfigError("too few points match to find the range of disparities: give --disparities MIN:MAX")
    return array, labels, rectified


def _rectified(arguments: argparse.Namespace) -> "RectifiedViews | None":
    """Read a folder of rectified views, or rectify views if cameras are given."""
    folders = [path for path in arguments.paths if Path(path).is_dir()]
    if not folders and arguments.cameras is None:
        return None
    from dvc.stereo.rectification.rectified_folder import as_views, read_rectified

    if not folders:
        return as_views(rectified_views(arguments, array_files.positions_of(arguments, arguments.paths)))
    if len(arguments.paths) > 1:
        raise ConfigError(f"{folders[0]}: a folder of rectified views excludes other views")
    if arguments.cameras or arguments.lattice or arguments.views:
        raise ConfigError(f"{folders[0]} has positions: it excludes --cameras, --lattice and --views")
    return read_rectified(Path(folders[0]))


def _truth(arguments: argparse.Namespace, array: "CameraArray") -> "Truth | None":
    from dvc.stereo.evaluation import evaluate
    from dvc.stereo.surface_report import Truth

    if arguments.truth is None:
        if arguments.mask is not None or arguments.truth_scale is not None:
            raise ConfigError("--mask and --truth-scale require --truth")
        return None
    truth, mask = read_truth_of(arguments)
    evaluate(truth, truth, mask)
    if truth.shape != array.shape:
        sizes = [f"{shape[1]}x{shape[0]}" for shape in (truth.shape, array.shape)]
        raise ConfigError(f"{arguments.truth}: {sizes[0]}, but the views are {sizes[1]}")
    return Truth(truth, mask)


def _write_shapes(paths: list[Path], result: "Reconstruction", rectification: "Rectification | None") -> None:
    """Write the surface of the reference view."""
    if not paths:
        return
    from dvc.stereo.meshes import points_in_world, points_of_disparity, surface_shape, write_shape

    view, surface = result.array[result.array.reference], result.surfaces[result.array.reference]
    mask = view.valid
    if rectification is None:
        points = points_of_disparity(surface.disparity, result.labels.lowest, result.labels.highest)
    else:
        points, finite = points_in_world(surface.disparity, view.position, rectification)
        mask = finite if mask is None else finite & mask
    step_px = max(1.5, 1.5 * result.labels.step)
    for path in paths:
        write_shape(path, surface_shape(points, view.image, surface.disparity, step_px, mask))


RECTIFY = Subcommand(
    "rectified views of calibrated or plain pictures",
    "Rectified views of cameras in a plane.",
    _add_rectify_options,
    _rectify,
    _RECTIFY_EXAMPLES,
)
RECONSTRUCT = Subcommand(
    "surfaces of all views",
    "Surfaces of all views, consistent with each other and with the points that they hide.",
    _add_reconstruct_options,
    _reconstruct,
    _RECONSTRUCT_EXAMPLES,
)
