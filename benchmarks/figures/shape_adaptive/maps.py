"""Maps that figures are measured on, and their files, each coded once."""

from collections.abc import Callable
from functools import cache

import numpy as np

from benchmarks.figures.dibr.rendered import STEP_M
from benchmarks.figures.harness import SCENES
from benchmarks.figures.stereo.runs import data_folder
from dvc.dibr.depth_image.depth_maps import default_hole, read_depth_map
from dvc.dibr.depth_image.depth_scale import Plane
from dvc.dibr.thesis.chapter4.curves import SHAPE_ADAPTIVE, STANDARD, MapPoint, map_point
from dvc.dibr.thesis.chapter4.material import MOTORCYCLE, Material, material_of_set, motorcycle
from sequences.renderer import render_picture
from sequences.scenes import scene

TEDDY = "teddy"
WIDTH, HEIGHT = 320, 240
"""Of rendered maps."""

_SCALES = {"teddy": 4.0, "cones": 4.0, "venus": 8.0}
OTHERS = "teddy disp6", "cones disp2", "cones disp6", "venus disp2", "venus disp6", MOTORCYCLE
"""Of the kind of Teddy's."""
RENDERED = SCENES
OTHER_TRUTHS = "cgtoy", "antinous"


@cache
def material(name: str) -> Material:
    """Load a map."""
    if name == MOTORCYCLE:
        return motorcycle()
    if name in RENDERED:
        return _rendered(name)
    if name in OTHER_TRUTHS:
        return _TRUTHS[name]()
    if " " not in name:
        return material_of_set(name, data_folder(name))
    folder, stem = name.split()
    path = data_folder(folder) / folder / f"{stem}.png"
    return _of_depth(name, read_depth_map(path, default_hole(path)).depth / _SCALES[folder])


def _of_depth(name: str, depth: Plane) -> Material:
    return Material(name, depth, float(np.ptp(depth)))


def _rendered(name: str) -> Material:
    """Exact disparities of a scene, for cameras that stand `STEP_M` apart."""
    _, depth, camera = render_picture(scene(name), 0, WIDTH, HEIGHT)
    return _of_depth(name, np.asarray(camera.K[0, 0] * STEP_M / depth, np.float64))


def _cgtoy() -> Material:
    path = data_folder("cgtoy") / "cgtoy" / "disp_Cam040.png"
    return _of_depth("cgtoy", read_depth_map(path).depth / 1024.0 - 16.0)


def _antinous() -> Material:
    path = data_folder("antinous") / "antinous" / "gt_disp_lowres.pfm"
    return _of_depth("antinous", read_depth_map(path).depth)


_TRUTHS: dict[str, Callable[[], Material]] = {"cgtoy": _cgtoy, "antinous": _antinous}


@cache
def coded(name: str, rate_bpp: float, transform: str = SHAPE_ADAPTIVE) -> MapPoint:
    """Code a map and decode it, as the commands do."""
    return map_point(material(name), rate_bpp, transform)


def gain_db(name: str, rate_bpp: float) -> float:
    """Return what edges gain at a rate."""
    return coded(name, rate_bpp).psnr_db - coded(name, rate_bpp, STANDARD).psnr_db
