"""Subcommands `dvc-stereo rectify` and `dvc-stereo reconstruct`, and the folder of rectified views."""

import argparse
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc import array_files, cli
from dvc.arrays import Bytes
from dvc.errors import ConfigError, DvcError
from dvc.files import atomic_folder, check_folder
from dvc.geometry.calibrated_cameras import LARGEST, Camera, camera_from_matrices
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.camera_files import AUTO
from dvc.index_files import read_index, read_labels, write_index
from dvc.picture_files import read_picture, read_plane, write_pfm, write_png
from dvc.stereo.evaluation import (
    Truth,
    check_views,
    evaluate,
    read_truth_of,
    reported,
    summary,
    write_previews,
    write_results,
)
from dvc.stereo.meshes import check_outputs, points_in_world, points_of_disparity, surface_shape, write_shape
from dvc.stereo.rectification.camera_lattice import Lattice
from dvc.stereo.rectification.rectified_array import (
    RectifiedArray,
    check_disparities,
    labels_of_matches,
    rectified_array,
)
from dvc.stereo.rectification.rectified_space import Rectification, metric_depth, to_original_view
from dvc.stereo.surfaces.reconstruct import most_steps, reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from dvc.stereo.surfaces.surface_folder import write_reconstruction
from dvc.web.gallery import PAGE

INDEX = "rectification.json"
FORMAT, VERSION = "dvc3d rectification", 1
MAX_VIEWS = 1 << 15
_MAX_SHOWN = 12
_PREVIEW_WIDTH_PX = 1600
_NUM_LINES = 8
_COLOURS = ((0, 255, 255), (255, 255, 0))


@dataclass(frozen=True, eq=False)
class RectifiedViews:
    """Rectified views, the disparities to try, and their transformation, also as values of the index."""

    array: CameraArray
    labels: DisparityLabels | None
    rectification: Rectification
    index: dict[str, Any]


def run_rectify(arguments: argparse.Namespace) -> int:
    """Write the rectified views of pictures."""
    check_folder(arguments.out)
    rectified = _rectified_array(arguments, with_matches=True)
    with atomic_folder(arguments.out) as folder:
        write_rectified(folder, _views_of(rectified))
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
    if not arguments.quiet:
        sys.stdout.write("".join(f"{line}\n" for line in lines))
    return 0


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
            rectification = rectified.rectification
            # the depth of every original picture, and its disparity and occlusions if it was resampled
            for index, (view, surface) in enumerate(zip(array, result.surfaces, strict=True)):
                disparity = to_original_view(rectification, index, surface.disparity)
                depth = metric_depth(rectification, index, disparity)
                write_pfm(folder / f"depth-{view.name}.pfm", depth)
                if not rectification.is_identity:
                    occluded = to_original_view(rectification, index, surface.occluded.astype(np.float32))
                    mask = (occluded > 0.5).astype(np.uint8) * 255
                    write_pfm(folder / f"original-disparity-{view.name}.pfm", disparity)
                    write_png(folder / f"original-occluded-{view.name}.png", mask)
        write_reconstruction(folder, result, arguments.jobs)
        write_previews(folder, result, truth, arguments.jobs)
    if shapes:
        view, surface = array[array.reference], result.surfaces[array.reference]
        inside = view.valid
        if rectified is None:
            points = points_of_disparity(surface.disparity, labels.lowest, labels.highest)
        else:
            points, finite = points_in_world(surface.disparity, view.position, rectified.rectification)
            inside = finite if inside is None else finite & inside
        step_px = max(1.5, 1.5 * labels.step)
        for path in shapes:
            write_shape(path, surface_shape(points, view.image, surface.disparity, step_px, inside))
    for warning in result.figures["warnings"]:
        sys.stderr.write(f"dvc-stereo: {cli.one_line(warning)}\n")
    text = f"{summary(result)}\n{arguments.out}: {Path(arguments.out) / PAGE} shows it"
    write_results(arguments.json, result.figures, "" if arguments.quiet else text)
    return 0


def _views(arguments: argparse.Namespace) -> tuple[CameraArray, DisparityLabels, RectifiedViews | None]:
    """Read the views, rectify them if cameras are given, and find disparities if none are given."""
    folders = [path for path in arguments.paths if Path(path).is_dir()]
    rectified = None
    if folders:
        if len(arguments.paths) > 1:
            raise ConfigError(f"{folders[0]}: a folder of rectified views excludes other views")
        if arguments.cameras or arguments.lattice or arguments.views:
            raise ConfigError(f"{folders[0]} has positions: it excludes --cameras, --lattice and --views")
        rectified = read_rectified(Path(folders[0]))
    elif arguments.cameras is not None:
        rectified = _views_of(_rectified_array(arguments))
    if rectified is None:
        array = array_files.load_array(arguments.paths, array_files.positions_of(arguments, arguments.paths))
        labels = arguments.disparities or labels_of_matches(array)
    else:
        array, labels = rectified.array, arguments.disparities or rectified.labels
    if labels is None:
        raise ConfigError("too few points match to find the range of disparities: give --disparities MIN:MAX")
    return array, labels, rectified


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
    return truth, mask


def _rectified_array(arguments: argparse.Namespace, with_matches: bool = False) -> RectifiedArray:
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


def _views_of(rectified: RectifiedArray) -> RectifiedViews:
    """Return rectified views with the values of the index: homographies, disparities, and agreement."""
    labels, matches = rectified.labels, rectified.matches
    index = {
        "disparities": None if labels is None else labels._asdict(),
        "num_matches": None if matches is None else len(matches.disparities),
        "row_rms_px": None if matches is None else matches.rms_px,
        "cameras_refined": rectified.refined,
        "off_plane_px": rectified.off_plane_px.tolist(),
        **rectified.rectification.to_dict(),
    }
    return RectifiedViews(rectified.array, labels, rectified.rectification, index)


def write_rectified(folder: Path, rectified: RectifiedViews) -> None:
    """Write pictures and masks of all views, `views.csv`, `rectification.json` and `preview.png`."""
    rows = ["file,m,n"]
    for view in rectified.array:
        write_png(folder / f"view-{view.name}.png", view.image[:, :, ::-1])
        write_png(folder / f"valid-{view.name}.png", view.seen.astype(np.uint8) * 255)
        rows.append(f"view-{view.name}.png,{view.position.m!r},{view.position.n!r}")
    (folder / "views.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_png(folder / "preview.png", preview(rectified.array))
    write_index(folder / INDEX, FORMAT, VERSION, rectified.index)


def read_rectified(folder: Path) -> RectifiedViews:
    """Read a folder of `write_rectified`."""
    index = read_index(folder / INDEX, FORMAT, VERSION, "dvc-stereo rectify")
    shape = index.shape()
    entry = index.entry("lattice")
    lattice = Lattice(*(entry.vector(key, 3, LARGEST) for key in ("origin", "v1", "v2")))
    if not lattice.spans_a_plane:
        entry.refuse("the steps 'v1' and 'v2' span no plane")
    cameras, views = list[Camera](), list[ArrayView]()
    for entry in index.entries("views", MAX_VIEWS):
        K, R, t = entry.matrix("K", 3), entry.matrix("R", 3), entry.vector("t", 3, LARGEST)
        camera = camera_from_matrices(entry.text("file"), K, R, t, entry.shape()[::-1])
        k1, k2, p1, p2 = entry.vector("distortion", 4).tolist()
        cameras.append(replace(camera, distortion=(k1, k2, p1, p2)))
        name = Path(entry.file("file").name).stem
        path = folder / f"view-{name}.png"
        valid = read_plane(folder / f"valid-{name}.png", 1, shape) > 127
        if not valid.any():
            raise DvcError(f"{path}: has no valid pixel")
        image = read_picture(path)
        if image.shape[:2] != shape:
            raise DvcError(f"{path}: {image.shape[1]}x{image.shape[0]}, expected {shape[1]}x{shape[0]}")
        position = LatticePosition(entry.number("m"), entry.number("n"))
        views.append(ArrayView(name, image, position, None if valid.all() else valid))
    positions = tuple(view.position for view in views)
    if len(positions) < 2 or len(set(positions)) < len(positions):
        index.refuse("fewer than two views, or two views at one position")
    x0, y0 = index.vector("offset_px", 2).tolist()
    focal, middle = index.number("focal_length_px", 0.0), index.number("middle_disparity")
    frame = (x0, y0), index.number("disparity_shift"), shape[::-1]
    rectification = Rectification(tuple(cameras), lattice, positions, focal, middle, *frame)
    labels = None if index.value("disparities") is None else read_labels(index.entry("disparities"))
    values = index.without("format", "version")
    return RectifiedViews(CameraArray(tuple(views)), labels, rectification, values)


def preview(array: CameraArray) -> Bytes:
    """Draw views next to each other, with lines along which their rows and columns must agree."""
    order = sorted(range(len(array)), key=lambda index: array[index].position[::-1])
    count = min(len(order), _MAX_SHOWN)
    across = 2 if count == 2 else math.ceil(math.sqrt(count))
    tiles = [array[order[k * len(order) // count]].image[:, :, ::-1].copy() for k in range(count)]
    for tile in tiles:
        height, width = tile.shape[:2]
        for k in range(1, _NUM_LINES):
            tile[k * height // _NUM_LINES] = _COLOURS[k % 2]
            tile[::4, k * width // _NUM_LINES] = _COLOURS[k % 2]
    tiles += [np.zeros_like(tiles[0])] * (-count % across)
    sheet = np.vstack([np.hstack(tiles[k : k + across]) for k in range(0, len(tiles), across)])
    scale = min(1.0, _PREVIEW_WIDTH_PX / sheet.shape[1])
    return np.asarray(cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
