"""Chapters 3 and 4: disparities coded with texture, and depth maps coded along their edges."""

from functools import cache
from pathlib import Path

from benchmarks.results.harness import Measured, Setting, mean_of
from benchmarks.results.stereo import data_folder
from benchmarks.thesis.harness import Method
from benchmarks.thesis.map_curves import (
    MAP_RATES,
    Material,
    map_point,
    material_of_set,
    picture_points,
    standard_point,
)
from benchmarks.thesis.scenes import FREE_SCENES, MOTORCYCLE, PAIRS, Scene, scene_of_array
from benchmarks.thesis.view_curves import (
    CODERS,
    QUICK_BPP,
    REFERENCE_BPP,
    Point,
    curve,
    differences,
    reference_multipliers,
)
from dvc.errors import DvcError

TEXTURE_DEPTH = ("teddy", "venus", "cones", "motorcycle")
DEPTH_RATE = 0.04
DEPTH = ("teddy", "cones", "venus", "motorcycle")
PICTURE_RATES, QUICK_PICTURE_RATES = (0.1, 0.3, 0.75), (0.3,)


@cache
def _scene(name: str) -> Scene:
    if name in PAIRS:
        return scene_of_array(PAIRS[name].pair(data_folder(name)), PAIRS[name].labels)
    return FREE_SCENES[name](Path())


@cache
def _curve(name: str, method: str, rates_bpp: tuple[float, ...]) -> list[Point]:
    views = _scene(name).views
    multipliers = reference_multipliers(views, rates_bpp)
    return curve(views, _scene(name).labels, CODERS[Method.DEFAULT][method], multipliers)


def over_quadtree(setting: Setting, method: str, names: tuple[str, ...] = TEXTURE_DEPTH) -> Measured:
    """Compare a way to code disparities with quadtrees of the same search: BD-rate of whole files."""
    rates, found = setting.choose(REFERENCE_BPP, QUICK_BPP), {}
    for name in names[: setting.choose(len(names), 1)]:
        both = differences(_curve(name, method, rates), _curve(name, "quadtree", rates))
        if both is None:
            raise DvcError(f"{name}: curves of {method} and of quadtrees have no PSNR in common")
        found[name] = both[1]
    return mean_of(found)


@cache
def _material(name: str) -> Material:
    return material_of_set(name, Path() if name == MOTORCYCLE else data_folder(name))


def _gain_db(name: str, rate_bpp: float) -> float:
    material = _material(name)
    return map_point(material, rate_bpp).psnr_db - standard_point(material, rate_bpp).psnr_db


def depth_gain(setting: Setting) -> Measured:
    """Code depth maps by wavelets that stop at edges and by standard ones, at one rate of whole files."""
    names = DEPTH[: setting.choose(len(DEPTH), 1)]
    return mean_of({name: _gain_db(name, DEPTH_RATE) for name in names})


def largest_depth_gain(setting: Setting) -> Measured:
    """Do the same with Teddy's map at many rates, and take the largest gain, as the thesis does."""
    rates = setting.choose(MAP_RATES, MAP_RATES[2:3])
    gains = {f"{rate:g} bit/pixel": _gain_db("teddy", rate) for rate in rates}
    return Measured(max(gains.values()), gains)


def picture_gain(setting: Setting) -> Measured:
    """Code the luma of Teddy's picture with the edges of its map and without, at equal bits."""
    teddy = _material("teddy")
    assert teddy.picture is not None
    edges = map_point(teddy, DEPTH_RATE).edges
    points = picture_points(teddy.picture, edges, setting.choose(PICTURE_RATES, QUICK_PICTURE_RATES))
    gains = {f"{point.rate_bpp:g} bit/pixel": point.chosen_db - point.standard_db for point in points}
    return Measured(max(gains.values()), gains)
