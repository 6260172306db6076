"""Chapters 3 and 4: disparities coded with texture, and depth maps coded along their edges."""

from functools import cache

from benchmarks.results.harness import Measured, Setting, mean_of
from benchmarks.results.stereo import data_folder
from dvc.dibr.stream.header import DisparityMethod
from dvc.dibr.thesis.chapter4.curves import MAP_RATES, STANDARD, map_point, picture_points
from dvc.dibr.thesis.chapter4.material import Material, load_material
from dvc.dibr.thesis.curves import Point, curve, differences
from dvc.dibr.thesis.scenes import Scene, load_scenes, scene_of_array
from dvc.errors import DvcError
from dvc.stereo.thesis.real_sets import PAIRS

LAMBDAS, QUICK_LAMBDAS = (1.2e-2, 4e-3, 1.5e-3, 4e-4), (1.2e-2, 4e-3)
"""Lagrange multipliers of files of about 0.1 to 1 bit per pixel."""
TEXTURE_DEPTH = ("teddy", "venus", "cones", "motorcycle")
DEPTH_RATE = 0.04
DEPTH = ("teddy", "cones", "venus", "motorcycle")
PICTURE_RATES, QUICK_PICTURE_RATES = (0.1, 0.3, 0.75), (0.3,)


@cache
def _scene(name: str) -> Scene:
    if name in PAIRS:
        one = PAIRS[name]
        return scene_of_array(name, one.pair(data_folder(name)), one.labels)
    (scene,) = load_scenes(None, [name])
    return scene


@cache
def _curve(name: str, method: str, multipliers: tuple[float, ...]) -> list[Point]:
    scene = _scene(name)
    return curve(scene.views, scene.labels, DisparityMethod[method.upper()], multipliers)


def over_quadtree(setting: Setting, method: str, names: tuple[str, ...] = TEXTURE_DEPTH) -> Measured:
    """Compare a way to code disparities of two views with quadtrees: BD-rate of whole files."""
    multipliers, found = setting.choose(LAMBDAS, QUICK_LAMBDAS), {}
    for name in names[: setting.choose(len(names), 1)]:
        both = differences(_curve(name, method, multipliers), _curve(name, "quadtree", multipliers))
        if both is None:
            raise DvcError(f"{name}: curves of {method} and of quadtrees have no PSNR in common")
        found[name] = both[1]
    return mean_of(found)


@cache
def _material(name: str) -> Material:
    (found,) = load_material(None if name == "motorcycle" else data_folder(name), [name])
    return found


def _gain_db(name: str, rate_bpp: float) -> float:
    shape_adaptive, standard = (map_point(_material(name), rate_bpp, *one) for one in ((), (STANDARD,)))
    return shape_adaptive.psnr_db - standard.psnr_db


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
    gains = {f"{point.rate_bpp:g} bit/pixel": point.gain_db for point in points}
    return Measured(max(gains.values()), gains)
