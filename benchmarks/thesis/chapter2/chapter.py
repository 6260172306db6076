"""Chapter 2 of the thesis: stereo from planar camera arrays."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.chapter import Chapter, Figure, Made, Step, Task, Value, Way
from benchmarks.thesis.chapter2 import pictures
from benchmarks.thesis.chapter2.as_written import READINGS, SETTINGS, SPRITES
from benchmarks.thesis.chapter2.two_planes import LABELS, two_planes
from benchmarks.thesis.real_sets import PAIRS, TSUKUBA, RealSet, check_sets
from benchmarks.thesis.toy import rectified_toy
from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.geometry.surfaces import Reconstruction
from dvc.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.layers.sprites import extract_sprites
from dvc.stereo.evaluation import MASKS, read_mask
from dvc.stereo.opencv_baseline import BASELINE as BASELINE_SETTINGS
from dvc.stereo.opencv_baseline import semi_global_baseline
from dvc.stereo.output.layer_pictures import draw_layers, draw_sprites, draw_surfaces, draw_values_per_pixel
from dvc.stereo.rectification.rectified_array import RectifiedArray
from dvc.stereo.rectification.rectified_folder import preview
from dvc.stereo.surfaces.reconstruction import reconstruct
from dvc.stereo.surfaces.settings import StereoSettings
from dvc.web.drawing import colour_disparity, in_rows, with_title

ITERATIONS = 1, 2
CROP = slice(40, 230), slice(120, 330)
"""Rows and columns of Tsukuba that figure 2.5 shows."""
TABLE = slice(60, 250), slice(180, 340)
"""Rows and columns of Tsukuba that figure 2.11 shows: what stands on the table."""
ON_THE_TABLE_PX = 6.5, 9.5
"""Disparities of that: the lamp is nearer, shelves and wall are farther."""
OCCLUSION_MODELS = {
    "none": "truncated cost",
    "implicit": "and implicit occlusion",
    "explicit": "and explicit visibility",
}
"""What figure 2.5 compares, by the name that the settings give it."""
CAMERAS, QUICK_CAMERAS = (2, 5, 25), (2, 5)
TABLE_2_1, TABLE_2_2, TABLE_2_3 = "Table 2.1", "Table 2.2", "Table 2.3"
BAD, VALUES = "{}: bad pixels, all [%]", "{} cameras: values [thousands]"
MORE = "{} cameras: more than one disparity map [%]"


def _surfaces(
    task: Task, array: CameraArray, labels: DisparityLabels, settings: StereoSettings
) -> Reconstruction:
    return reconstruct(array, labels, settings, jobs=task.jobs)


def _folder(task: Task) -> Path:
    assert task.data is not None, "steps of real sets are there only with data"
    return task.data


def _bad(task: Task, one: RealSet, disparity: NDArray[np.floating]) -> dict[str, float]:
    """Return bad pixels beyond 1 px in per cent, by mask."""
    found = one.evaluate(_folder(task), disparity)
    return {mask: result.bad_percent[1.0] for mask, result in found.items()}


def _two_planes(task: Task, way: Way) -> Made:
    """Figure 2.4."""
    array, truth = two_planes()
    found = {
        iterations: _surfaces(task, array, LABELS, replace(SETTINGS[way], max_iterations=iterations))
        for iterations in ITERATIONS
    }
    return Made(pictures={("2.4", ""): pictures.figure_2_4(truth, found)})


@cache
def _toy_array() -> RectifiedArray:
    return rectified_toy()


def _toy(task: Task, way: Way) -> Made:
    """Figures 2.2 and 2.8."""
    rectified = _toy_array()
    array, labels = rectified.array, rectified.labels
    if labels is None:
        raise DvcError("toy: no disparities were found")
    found = _surfaces(task, array, labels, SETTINGS[way])
    maps = [
        with_title(colour_disparity(surface.disparity, labels.lowest, labels.highest), view.name)
        for view, surface in zip(array, found.surfaces, strict=True)
    ]
    return Made(pictures={("2.2", ""): preview(array), ("2.8", ""): in_rows(maps, 2)})


def _occlusion_models(task: Task, way: Way) -> Made:
    """Figure 2.5."""
    data, made = _folder(task), Made()
    array, truth = TSUKUBA.array(data, 5), TSUKUBA.true_disparity(data)
    mask = read_mask(data / TSUKUBA.name / "all.png")
    panels = []
    for model, title in OCCLUSION_MODELS.items():
        settings = replace(SETTINGS[way], cost="squared", occlusion=model)
        disparity = _surfaces(task, array, TSUKUBA.labels, settings).surfaces[array.reference].disparity
        panels += pictures.disparity_panels(disparity[CROP], truth[CROP], TSUKUBA.labels, title, mask[CROP])
        made.values.append(Value("Figure 2.5", BAD.format(title), _bad(task, TSUKUBA, disparity)["all"]))
    made.pictures["2.5", ""] = in_rows(panels[::2] + panels[1::2], len(OCCLUSION_MODELS))
    return made


def _pair(name: str, task: Task, way: Way) -> Made:
    """A column of table 2.1 and a row of figure 2.9."""
    one, data = PAIRS[name], _folder(task)
    array, truth = one.pair(data), one.true_disparity(data)
    disparity = _surfaces(task, array, one.labels, SETTINGS[way]).surfaces[0].disparity
    bad, made = _bad(task, one, disparity), Made()
    made.values = [Value(TABLE_2_1, f"{name}: bad pixels, {mask} [%]", bad[mask]) for mask in ("all", *MASKS)]
    if way is Way.OURS:
        raw = _surfaces(task, array, one.labels, replace(SETTINGS[way], cost="squared")).surfaces[0].disparity
        baseline = semi_global_baseline(array[0].image, array[1].image, one.labels.highest)
        others: dict[str, NDArray[np.floating]] = {
            "with the squared difference": raw,
            "StereoSGBM, holes filled": baseline,
        }
        made.values += [
            Value(TABLE_2_1, BAD.format(f"{name}, {told}"), _bad(task, one, found)["all"])
            for told, found in others.items()
        ]
    mask = read_mask(data / name / "all.png")
    known = with_title(colour_disparity(truth, one.labels.lowest, one.labels.highest), "truth")
    panels = [pictures.view_panel(array[0]), known]
    panels += pictures.disparity_panels(disparity, truth, one.labels, name, mask)
    made.pictures["2.9", name] = in_rows(panels, 4)
    return made


def _cameras(cameras: int, is_last: bool, task: Task, way: Way) -> Made:
    """Rows of tables 2.2 and 2.3, and what figures 2.6, 2.7, 2.10 and 2.11 show of so many cameras."""
    array = TSUKUBA.array(_folder(task), cameras)
    found = _surfaces(task, array, TSUKUBA.labels, SETTINGS[way])
    bad = _bad(task, TSUKUBA, found.surfaces[array.reference].disparity)
    image = _layers(found, way)
    counts, made = image.counts(), Made()
    made.values = [
        Value(TABLE_2_2, BAD.format(f"{cameras} cameras"), bad["all"]),
        Value(TABLE_2_3, VALUES.format(cameras), counts["num_values_inside"] / 1000.0, ".0f"),
        Value(TABLE_2_3, MORE.format(cameras), counts["increase_percent"], "+.1f"),
        Value(TABLE_2_3, f"{cameras} cameras: layers", counts["num_layers"], "d"),
        Value(
            TABLE_2_3,
            f"{cameras} cameras: values beyond the frame [thousands]",
            counts["num_values_beyond"] / 1000.0,
            ".0f",
        ),
    ]
    named = f"{cameras} cameras"
    made.pictures["2.10", named] = draw_values_per_pixel(image)
    made.pictures["2.11", named] = draw_surfaces(image, *ON_THE_TABLE_PX, TABLE)
    if is_last:
        made.pictures["2.6", named] = draw_layers(image)
        made.pictures["2.7", named] = draw_sprites(extract_sprites(image, SPRITES[way]), 12, 3)
    return made


def _layers(found: Reconstruction, way: Way) -> LayeredDepthImage:
    """Layers of what cameras vote for: as written, all that they have found."""
    if way is Way.OURS:
        return layered_depth_image(found)
    return layered_depth_image(found, [view.seen for view in found.array])


def _steps(task: Task) -> list[Step]:
    steps = [Step("two-planes", _two_planes), Step("toy", _toy)]
    if task.data is None:
        if task.chosen:
            raise ConfigError(f"{task.chosen[0]}: real sets are those of a folder, --data")
        return steps
    check_sets(task.data, task.chosen or tuple(PAIRS))
    unknown = [name for name in task.chosen if name not in PAIRS]
    if unknown:
        raise ConfigError(f"{unknown[0]}: chapter 2 has the sets {', '.join(PAIRS)}")
    names = task.chosen or tuple(PAIRS)
    steps += [Step(f"pair-{name}", partial(_pair, name)) for name in names]
    if TSUKUBA.name in names:
        cameras = CAMERAS if task.full else QUICK_CAMERAS
        steps.append(Step("occlusion-models", _occlusion_models))
        steps += [Step(f"cameras-{n}", partial(_cameras, n, n == cameras[-1])) for n in cameras]
    return steps


_DIAGRAM = "a diagram of the method"
_REST = "what others have reached is not measured again"


def _printed() -> dict[tuple[str, str], str]:
    proposed, best = ("1.53", "1.04", "10.9", "8.65"), ("1.29", "0.21", "6.54", "7.86")
    printed = {(TABLE_2_1, BAD.format(name)): value for name, value in zip(PAIRS, proposed, strict=True)}
    printed |= {
        (TABLE_2_1, BAD.format(f"{name}, best method of the time")): value
        for name, value in zip(PAIRS, best, strict=True)
    }
    printed |= {
        (TABLE_2_2, BAD.format(f"{n} cameras")): bad for n, bad in ((2, "1.5"), (5, "1.3"), (25, "1.3"))
    }
    for told, value in (
        ("2 cameras, New Kolmogorov and Zabih 2005", "2.2"),
        ("2 cameras, Wei and Quan 2005", "2.7"),
        ("5 cameras, New Kolmogorov and Zabih 2005", "1.3"),
        ("5 cameras, Wei and Quan 2005", "1.3"),
        ("5 cameras, Drouin et al. 2005", "2.2"),
        ("5 cameras, Kolmogorov and Zabih 2002", "2.3"),
    ):
        printed[TABLE_2_2, BAD.format(told)] = value
    for cameras, values, more in ((2, "108", "+2.1"), (5, "116", "+9.7"), (25, "127", "+19.4")):
        printed[TABLE_2_3, VALUES.format(cameras)] = values
        printed[TABLE_2_3, MORE.format(cameras)] = more
    printed[TABLE_2_3, "25 cameras: layers"] = "3"
    return printed


CHAPTER = Chapter(
    2,
    "symmetric stereo reconstruction from planar camera arrays",
    _printed(),
    (
        Figure("2.1", "rays in the rectified space", _DIAGRAM),
        Figure(
            "2.2",
            "the toy array, rectified",
            "the views of the thesis are not public; a rendered array instead",
        ),
        Figure("2.3", "the field of cameras", _DIAGRAM),
        Figure("2.4", "how the occlusion model works", "made up as the thesis describes it"),
        Figure("2.5", "occlusion models on Tsukuba, five cameras"),
        Figure("2.6", "layers of Tsukuba", "of the most cameras that were measured; 25 with --preset full"),
        Figure("2.7", "sprites of Tsukuba", "of the most cameras that were measured; 25 with --preset full"),
        Figure("2.8", "disparities of the toy array", "of the rendered array"),
        Figure("2.9", "disparities of the Middlebury pairs"),
        Figure("2.10", "values per pixel on Tsukuba", "25 cameras with --preset full"),
        Figure("2.11", "textures of what stands on the table", "25 cameras with --preset full"),
    ),
    (
        *READINGS,
        f"Best methods, ranks and rows of others in tables 2.1 and 2.2: {_REST}. Ours beside them: "
        f"{BASELINE_SETTINGS}.",
    ),
    _steps,
)
