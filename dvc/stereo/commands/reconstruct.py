"""`dvc-stereo reconstruct`: surfaces of all views, consistent with each other."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import array_files, cli
from dvc.errors import ConfigError
from dvc.stereo.commands.options import add_export_options, add_truth_options, check_outputs, read_truth_of
from dvc.stereo.commands.views import rectified_views
from dvc.stereo.surfaces.settings import COST_NAMES, INFERENCE_NAMES, OCCLUSION_NAMES, StereoSettings

if TYPE_CHECKING:
    from dvc.geometry.camera_array import CameraArray, DisparityLabels
    from dvc.geometry.surfaces import Reconstruction
    from dvc.stereo.output.report import Truth
    from dvc.stereo.rectification.rectified_folder import RectifiedViews
    from dvc.stereo.rectification.rectified_space import Rectification


SUMMARY = "surfaces of all views"
DESCRIPTION = "Surfaces of all views, consistent with each other and with what they hide."
EXAMPLES = """\
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo reconstruct a.png b.png c.png --lattice -1,0 0,0 1,0 --disparities -4:12:0.5 --out surfaces
  dvc-stereo reconstruct *.png --views views.csv --disparities 0:16 --out surfaces --ply surfaces.ply
  dvc-stereo reconstruct im2.png im6.png --disparities 0:60 --truth disp2.png --truth-scale 4 --out teddy
  dvc-stereo reconstruct *.jpg --cameras auto --out surfaces
  dvc-stereo reconstruct rectified --out surfaces
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    views = "picture of a camera; or the folder that `dvc-stereo rectify` has written"
    parser.add_argument("paths", nargs="+", metavar="VIEW", help=views)
    array_files.add_array_options(parser)
    array_files.add_camera_option(parser)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    add_truth_options(parser, required=False)
    parser.add_argument(
        "--json", metavar="FILE", help="write the results; - for standard output, in place of text"
    )
    add_export_options(parser)
    _add_method(parser)
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no summary")


def _add_method(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("how surfaces are found")
    cost = "census: robust, summed over regions of one colour; squared: pixels by themselves; default: census"
    group.add_argument("--cost", choices=COST_NAMES, default="census", help=cost)
    group.add_argument(
        "--inference",
        choices=INFERENCE_NAMES,
        default=StereoSettings.inference,
        help="messages between neighbours, or scanlines alone: faster; default: %(default)s",
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
        "times that surfaces are found, at most; large views begin with their smallest size, for which this"
        " counts, and take two more for each larger one",
        default=3,
    )
    group.add_argument("--sub-pixel", action="store_true", help="disparities between those of --disparities")
    cli.add_integer(group, "--jobs", (1, 256), "threads; the result is the same", default=1)


def run(arguments: argparse.Namespace) -> int:
    """Reconstruct."""
    from dvc.files import atomic_folder
    from dvc.stereo.output.report import check_views, reported, summary, write_previews
    from dvc.stereo.rectification.disparity_range import check_disparities
    from dvc.stereo.surfaces.folder import write_reconstruction
    from dvc.stereo.surfaces.reconstruction import most_steps, reconstruct

    maps = [name for name in (arguments.truth, arguments.mask) if name is not None]
    shapes = check_outputs(arguments, [*arguments.paths, *array_files.table_files(arguments), *maps])
    array, labels, rectified = _views(arguments)
    rectification = None if rectified is None else rectified.rectification
    truth = _truth(arguments, array)
    warnings = check_views(array, labels)
    if rectified is None and arguments.disparities is not None:
        check_disparities(array, labels, arguments.jobs)
    settings = _settings(arguments)
    with atomic_folder(arguments.out) as folder:
        total = most_steps(array, labels, settings)
        with cli.progress_bar("surfaces", total, arguments.quiet) as advance:
            found = reconstruct(array, labels, settings, jobs=arguments.jobs, advance=advance)
        found = reported(found, truth, warnings)
        if rectified is not None:
            from dvc.stereo.rectification.rectified_folder import write_original_views

            found.figures["rectification"] = rectified.index
            write_original_views(folder, found, rectified.rectification)
        write_reconstruction(folder, found, arguments.jobs)
        write_previews(folder, found, truth, arguments.jobs)
    _write_shapes(shapes, found, rectification)
    for warning in found.figures["warnings"]:
        sys.stderr.write(f"dvc-stereo: {cli.one_line(warning)}\n")
    if arguments.json is not None:
        cli.write_json(arguments.json, found.figures)
    if not arguments.quiet and arguments.json != "-":
        sys.stdout.write(
            f"{summary(found)}\n{arguments.out}: {Path(arguments.out) / 'index.html'} shows it\n"
        )
    return 0


def _settings(arguments: argparse.Namespace) -> "StereoSettings":

    return StereoSettings(
        cost=arguments.cost,
        inference=arguments.inference,
        occlusion=arguments.occlusion,
        max_iterations=arguments.iterations,
        sub_pixel=arguments.sub_pixel,
    )


def _views(
    arguments: argparse.Namespace,
) -> tuple["CameraArray", "DisparityLabels", "RectifiedViews | None"]:
    """Read the views, and rectify them where cameras are given; find disparities where none are."""
    rectified = _rectified(arguments)
    if rectified is None:
        array = array_files.load_array(arguments.paths, array_files.positions_of(arguments, arguments.paths))
        labels = arguments.disparities or _found_labels(array)
    else:
        array, labels = rectified.array, arguments.disparities or rectified.labels
    if labels is None:
        raise ConfigError("too few points match to find the range of disparities: give --disparities MIN:MAX")
    return array, labels, rectified


def _rectified(arguments: argparse.Namespace) -> "RectifiedViews | None":
    """Read a folder of rectified views, or make them where cameras are given."""
    folders = [path for path in arguments.paths if Path(path).is_dir()]
    if not folders and arguments.cameras is None:
        return None
    from dvc.stereo.rectification.rectified_folder import as_views, read_rectified

    if not folders:
        return as_views(rectified_views(arguments, array_files.positions_of(arguments, arguments.paths)))
    if len(arguments.paths) > 1:
        raise ConfigError(f"{folders[0]}: a folder of rectified views stands alone")
    if arguments.cameras or arguments.lattice or arguments.views:
        raise ConfigError(f"{folders[0]} says where its cameras stand: no --cameras, --lattice or --views")
    return read_rectified(Path(folders[0]))


def _found_labels(array: "CameraArray") -> "DisparityLabels | None":
    from dvc.stereo.rectification.disparity_range import found_labels

    return found_labels(array)


def _truth(arguments: argparse.Namespace, array: "CameraArray") -> "Truth | None":
    from dvc.stereo.evaluation import evaluate
    from dvc.stereo.output.report import Truth

    if arguments.truth is None:
        if arguments.mask is not None or arguments.truth_scale is not None:
            raise ConfigError("--mask and --truth-scale need --truth")
        return None
    truth, mask = read_truth_of(arguments)
    evaluate(truth, truth, mask)
    if truth.shape != array.shape:
        sizes = [f"{shape[1]}x{shape[0]}" for shape in (truth.shape, array.shape)]
        raise ConfigError(f"{arguments.truth}: {sizes[0]}, but the views are {sizes[1]}")
    return Truth(truth, mask)


def _write_shapes(paths: list[Path], found: "Reconstruction", rectification: "Rectification | None") -> None:
    """Write the surface of the reference view."""
    if not paths:
        return
    from dvc.stereo.output.export import points_in_world, points_of_disparity, surface_shape, write_shape

    view, surface = found.array[found.array.reference], found.surfaces[found.array.reference]
    kept = view.valid
    if rectification is None:
        points = points_of_disparity(surface.disparity, found.labels.lowest, found.labels.highest)
    else:
        points, known = points_in_world(surface.disparity, view.position, rectification)
        kept = known if kept is None else known & kept
    step_px = max(1.5, 1.5 * found.labels.step)
    for path in paths:
        write_shape(path, surface_shape(points, view.image, surface.disparity, step_px, kept))
