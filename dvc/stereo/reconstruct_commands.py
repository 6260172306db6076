"""Subcommands `dvc-stereo rectify` and `dvc-stereo reconstruct`."""

import argparse
import sys
from pathlib import Path

from dvc import array_files, cli
from dvc.errors import ConfigError
from dvc.files import atomic_folder, check_folder
from dvc.geometry.camera_array import CameraArray, DisparityLabels, Reconstruction
from dvc.geometry.camera_files import AUTO
from dvc.stereo.evaluation import evaluate, read_truth_of
from dvc.stereo.meshes import points_in_world, points_of_disparity, surface_shape, write_shape
from dvc.stereo.rectification.rectified_array import (
    RectifiedArray,
    check_disparities,
    labels_of_matches,
    rectified_array,
)
from dvc.stereo.rectification.rectified_folder import (
    RectifiedViews,
    as_views,
    read_rectified,
    write_original_views,
    write_rectified,
)
from dvc.stereo.rectification.rectified_space import Rectification
from dvc.stereo.stereo_options import check_outputs, write_results
from dvc.stereo.surface_report import Truth, check_views, reported, summary, write_previews
from dvc.stereo.surfaces.reconstruct import most_steps, reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from dvc.stereo.surfaces.surface_folder import write_reconstruction


def run_rectify(arguments: argparse.Namespace) -> int:
    """Write the rectified views of pictures."""
    check_folder(arguments.out)
    rectified = _rectified_views(arguments, with_matches=True)
    with atomic_folder(arguments.out) as folder:
        write_rectified(folder, rectified)
    if not arguments.quiet:
        sys.stdout.write(_rectification_text(rectified))
    return 0


def _rectification_text(rectified: RectifiedArray) -> str:
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


def run_reconstruct(arguments: argparse.Namespace) -> int:
    """Write the surfaces of all views."""
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


def _views(arguments: argparse.Namespace) -> tuple[CameraArray, DisparityLabels, RectifiedViews | None]:
    """Read the views, rectify them if cameras are given, and find disparities if none are given."""
    rectified = _rectified(arguments)
    if rectified is None:
        array = array_files.load_array(arguments.paths, array_files.positions_of(arguments, arguments.paths))
        labels = arguments.disparities or labels_of_matches(array)
    else:
        array, labels = rectified.array, arguments.disparities or rectified.labels
    if labels is None:
        raise ConfigError("too few points match to find the range of disparities: give --disparities MIN:MAX")
    return array, labels, rectified


def _rectified(arguments: argparse.Namespace) -> RectifiedViews | None:
    """Read a folder of rectified views, or rectify views if cameras are given."""
    folders = [path for path in arguments.paths if Path(path).is_dir()]
    if not folders and arguments.cameras is None:
        return None
    if not folders:
        return as_views(_rectified_views(arguments))
    if len(arguments.paths) > 1:
        raise ConfigError(f"{folders[0]}: a folder of rectified views excludes other views")
    if arguments.cameras or arguments.lattice or arguments.views:
        raise ConfigError(f"{folders[0]} has positions: it excludes --cameras, --lattice and --views")
    return read_rectified(Path(folders[0]))


def _truth(arguments: argparse.Namespace, array: CameraArray) -> Truth | None:
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


def _write_shapes(paths: list[Path], result: Reconstruction, rectification: Rectification | None) -> None:
    """Write the surface of the reference view."""
    if not paths:
        return
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


def _rectified_views(arguments: argparse.Namespace, with_matches: bool = False) -> RectifiedArray:
    """Read pictures and rectify them."""
    positions = array_files.positions_of(arguments, arguments.paths)
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
