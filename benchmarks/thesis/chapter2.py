"""Chapter 2 of the thesis: stereo from planar camera arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.opencv_stereo import BASELINE as BASELINE_SETTINGS
from benchmarks.baselines.opencv_stereo import semi_global_baseline
from benchmarks.thesis.harness import Method, Step, StepResult, Task, Value, load_chapter
from benchmarks.thesis.scenes import MASKS, PAIRS, TSUKUBA, RealSet, check_names, rectified_toy
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition, Reconstruction
from dvc.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.layers.sprites import SpriteSettings, extract_sprites
from dvc.stereo.evaluation import disparity_error, read_mask
from dvc.stereo.layer_commands import PAPER, draw_layers, draw_sprites, draw_values_per_pixel
from dvc.stereo.reconstruct_commands import preview
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from dvc.web.drawing import Picture, colour_disparity, colour_error, in_rows, with_title

Floats = NDArray[np.floating]

GEOMETRIC_WEIGHT, GEOMETRIC_LIMIT = 0.1, 3.0
"""lambda_g of (2.13), as a share of tau_2, and tau_1 of (2.16), in labels."""
UNDEFINED_COST = 0.2
"""Cost that (2.20) leaves open, as a share of tau_2: somewhat more than that of good matches."""
THESIS = StereoSettings(
    cost="squared",
    agreement="exact",
    filling="inferred",
    max_iterations=5,  # as for figure 2.8, the only number that the text gives
    min_change=0.0,
    geometric_weight=GEOMETRIC_WEIGHT,
    geometric_limit=GEOMETRIC_LIMIT,
    edge_strength=1.0,
    undefined_cost=UNDEFINED_COST,
    exposures=False,
)
SETTINGS = {Method.THESIS: THESIS, Method.DEFAULT: StereoSettings()}
SPRITES = {Method.THESIS: SpriteSettings(space="depth"), Method.DEFAULT: SpriteSettings()}

HEIGHT, WIDTH = 60, 96
FAR, NEAR = 2, 10
LABELS = DisparityLabels(0.0, 1.0, 13)
"""Views of figure 2.4, and disparities of background and square."""
TOP, LEFT, SIDE = 15, 33, 30
"""Square in the middle view."""
BACKGROUND, SQUARE, TEXTURE = 200.0, 60.0, 18.0
"""Mean levels of both, and the deviation of the texture that distinguishes surfaces."""

CROP = slice(40, 230), slice(120, 330)
"""Rows and columns of Tsukuba in figure 2.5."""
TABLE_TOP, TABLE_TOP_PX = (slice(60, 250), slice(180, 340)), (6.5, 9.5)
"""Rows, columns and disparities of the objects on the table in figure 2.11, without lamp and wall."""
OCCLUSION_MODELS = {
    "none": "truncated cost",
    "implicit": "and implicit occlusion",
    "explicit": "and explicit visibility",
}
"""Models of figure 2.5 by their names in the settings."""
CAMERAS, QUICK_CAMERAS = (2, 5, 25), (2, 5)
TABLE_2_1, TABLE_2_2, TABLE_2_3 = "Table 2.1", "Table 2.2", "Table 2.3"
BAD, VALUES = "{}: bad pixels, all [%]", "{} cameras: values [thousands]"
SEVERAL = "{} cameras: more than one disparity map [%]"


def two_planes() -> tuple[CameraArray, list[NDArray[np.float64]]]:
    """Make the three views of figure 2.4: a dark square before a bright background."""
    rng = np.random.default_rng(24)
    far = np.clip(rng.normal(BACKGROUND, TEXTURE, (HEIGHT, WIDTH + 2 * FAR)), 0, 255).astype(np.uint8)
    near = np.clip(rng.normal(SQUARE, TEXTURE, (SIDE, SIDE)), 0, 255).astype(np.uint8)
    views, truth = [], []
    for m, name in ((-1, "left"), (0, "middle"), (1, "right")):
        image = far[:, FAR * (m + 1) : FAR * (m + 1) + WIDTH].copy()
        disparity = np.full((HEIGHT, WIDTH), float(FAR))
        square = slice(TOP, TOP + SIDE), slice(LEFT - m * NEAR, LEFT - m * NEAR + SIDE)
        image[square], disparity[square] = near, NEAR
        views.append(ArrayView(name, np.repeat(image[:, :, None], 3, axis=2), LatticePosition(float(m), 0.0)))
        truth.append(disparity)
    return CameraArray(tuple(views)), truth


def _folder(task: Task) -> Path:
    assert task.data is not None, "real sets need data"
    return task.data


def _reconstructed(
    task: Task, array: CameraArray, labels: DisparityLabels, settings: StereoSettings
) -> Reconstruction:
    return reconstruct(array, labels, settings, jobs=task.jobs)


def _bad(task: Task, real_set: RealSet, disparity: Floats) -> dict[str, float]:
    """Return bad pixels beyond 1 px in per cent, by mask."""
    evaluations = real_set.evaluate(_folder(task), disparity)
    return {mask: evaluation.bad_percent[1.0] for mask, evaluation in evaluations.items()}


def _disparity_panels(
    disparity: Floats,
    truth: Floats,
    labels: DisparityLabels,
    title: str,
    mask: NDArray[np.bool_] | None = None,
) -> list[Picture]:
    """Draw a disparity map and its errors."""
    error, counted = disparity_error(disparity, truth, mask)
    bad = 100.0 * float(np.mean(error[counted] > 1.0))
    return [
        with_title(colour_disparity(disparity, labels.lowest, labels.highest), title),
        with_title(colour_error(error, counted), f"{bad:.2f} % bad"),
    ]


def _two_planes(task: Task, method: Method) -> StepResult:
    """Draw figure 2.4: views, then disparities and errors after each iteration."""
    array, truth = two_planes()
    panels = [_enlarged(np.ascontiguousarray(view.image[:, :, ::-1]), view.name) for view in array]
    for iterations in (1, 2):
        settings = replace(SETTINGS[method], max_iterations=iterations)
        surfaces = _reconstructed(task, array, LABELS, settings).surfaces
        for surface in surfaces:
            drawn = colour_disparity(surface.disparity, LABELS.lowest, LABELS.highest)
            panels.append(_enlarged(drawn, f"iteration {iterations}"))
        for surface, true in zip(surfaces, truth, strict=True):
            error, counted = disparity_error(surface.disparity, true)
            bad = 100.0 * float(np.mean(error[counted] > 1.0))
            panels.append(_enlarged(colour_error(error, counted), f"{bad:.1f} % bad"))
    return StepResult(pictures={("2.4", ""): in_rows(panels, len(array))})


def _enlarged(picture: Picture, title: str) -> Picture:
    doubled = cv2.resize(picture, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    return with_title(np.asarray(doubled, np.uint8), title)


_toy_array = cache(rectified_toy)


def _toy(task: Task, method: Method) -> StepResult:
    """Draw figures 2.2 and 2.8."""
    rectified, labels = _toy_array()
    surfaces = _reconstructed(task, rectified.array, labels, SETTINGS[method]).surfaces
    maps = [
        with_title(colour_disparity(surface.disparity, labels.lowest, labels.highest), view.name)
        for view, surface in zip(rectified.array, surfaces, strict=True)
    ]
    return StepResult(pictures={("2.2", ""): preview(rectified.array), ("2.8", ""): in_rows(maps, 2)})


def _occlusion_models(task: Task, method: Method) -> StepResult:
    """Measure figure 2.5."""
    data, result = _folder(task), StepResult()
    array, truth = TSUKUBA.array(data, 5), TSUKUBA.true_disparity(data)
    mask = read_mask(data / TSUKUBA.name / "all.png")
    panels = []
    for model, title in OCCLUSION_MODELS.items():
        settings = replace(SETTINGS[method], cost="squared", occlusion=model)
        surfaces = _reconstructed(task, array, TSUKUBA.labels, settings).surfaces
        disparity = surfaces[array.reference].disparity
        panels += _disparity_panels(disparity[CROP], truth[CROP], TSUKUBA.labels, title, mask[CROP])
        bad = _bad(task, TSUKUBA, disparity)["all"]
        result.values.append(Value("Figure 2.5", BAD.format(title), bad))
    result.pictures["2.5", ""] = in_rows(panels[::2] + panels[1::2], len(OCCLUSION_MODELS))
    return result


def _pair(name: str, task: Task, method: Method) -> StepResult:
    """Measure a column of table 2.1 and a row of figure 2.9."""
    real_set, data = PAIRS[name], _folder(task)
    array, truth, labels = real_set.pair(data), real_set.true_disparity(data), real_set.labels
    disparity = _reconstructed(task, array, labels, SETTINGS[method]).surfaces[0].disparity
    bad = _bad(task, real_set, disparity)
    values = [Value(TABLE_2_1, f"{name}: bad pixels, {mask} [%]", bad[mask]) for mask in ("all", *MASKS)]
    if method is Method.DEFAULT:
        squared = replace(SETTINGS[method], cost="squared")
        variants: Mapping[str, Floats] = {
            "with the squared difference": _reconstructed(task, array, labels, squared).surfaces[0].disparity,
            "StereoSGBM, holes filled": semi_global_baseline(array[0].image, array[1].image, labels.highest),
        }
        for variant, found in variants.items():
            label = BAD.format(f"{name}, {variant}")
            values.append(Value(TABLE_2_1, label, _bad(task, real_set, found)["all"]))
    view = array[0]
    title = f"view ({view.position.m:g}, {view.position.n:g})"
    panels = [
        with_title(np.ascontiguousarray(view.image[:, :, ::-1]), title),
        with_title(colour_disparity(truth, labels.lowest, labels.highest), "truth"),
        *_disparity_panels(disparity, truth, labels, name, read_mask(data / name / "all.png")),
    ]
    return StepResult(values, pictures={("2.9", name): in_rows(panels, 4)})


def _cameras(cameras: int, is_last: bool, task: Task, method: Method) -> StepResult:
    """Measure rows of tables 2.2 and 2.3, and figures 2.6, 2.7, 2.10 and 2.11, for a number of cameras."""
    array = TSUKUBA.array(_folder(task), cameras)
    reconstruction = _reconstructed(task, array, TSUKUBA.labels, SETTINGS[method])
    bad = _bad(task, TSUKUBA, reconstruction.surfaces[array.reference].disparity)["all"]
    # as written, cameras vote with all of their voxels
    votes = None if method is Method.DEFAULT else [view.seen for view in array]
    image = layered_depth_image(reconstruction, votes)
    counts, label = image.counts(), f"{cameras} cameras"
    beyond = counts["num_values_beyond"] / 1000.0
    values = [
        Value(TABLE_2_2, BAD.format(label), bad),
        Value(TABLE_2_3, VALUES.format(cameras), counts["num_values_inside"] / 1000.0, ".0f"),
        Value(TABLE_2_3, SEVERAL.format(cameras), counts["increase_percent"], "+.1f"),
        Value(TABLE_2_3, f"{label}: layers", counts["num_layers"], "d"),
        Value(TABLE_2_3, f"{label}: values beyond the frame [thousands]", beyond, ".0f"),
    ]
    pictures = {
        ("2.10", label): draw_values_per_pixel(image),
        ("2.11", label): draw_surfaces(image, *TABLE_TOP_PX, TABLE_TOP),
    }
    if is_last:
        pictures["2.6", label] = draw_layers(image)
        pictures["2.7", label] = draw_sprites(extract_sprites(image, SPRITES[method]), 12, 3)
    return StepResult(values, pictures=pictures)


def draw_surfaces(
    image: LayeredDepthImage, lowest: float, highest: float, window: tuple[slice, slice]
) -> Picture:
    """Draw the surfaces in a range of disparity without those before them, as figure 2.11."""
    frame, shape = image.canvas.frame, image.canvas.shape
    rows = np.arange(window[0].start, window[0].stop) + frame.top
    columns = np.arange(window[1].start, window[1].stop) + frame.left
    chosen = image.occupied & (image.disparity >= lowest) & (image.disparity <= highest)
    picture = np.broadcast_to(PAPER, (*shape, 3)).copy()
    for colour, mask in zip(image.colour[::-1], chosen[::-1], strict=True):
        picture[mask] = colour[mask][:, ::-1]
    inside = ((rows >= 0) & (rows < shape[0]))[:, None] & ((columns >= 0) & (columns < shape[1]))
    cut = picture[np.clip(rows, 0, shape[0] - 1)[:, None], np.clip(columns, 0, shape[1] - 1)]
    return np.where(inside[..., None], cut, PAPER)


def _steps(task: Task) -> Sequence[Step]:
    steps = [Step("two-planes", _two_planes), Step("toy", _toy)]
    if task.data is None and not task.chosen:
        return steps
    names = task.chosen or tuple(PAIRS)
    check_names(names, task.data, tuple(PAIRS), (), "")
    steps += [Step(f"pair-{name}", partial(_pair, name)) for name in names]
    if TSUKUBA.name in names:
        cameras = CAMERAS if task.full else QUICK_CAMERAS
        steps.append(Step("occlusion-models", _occlusion_models))
        steps += [Step(f"cameras-{n}", partial(_cameras, n, n == cameras[-1])) for n in cameras]
    return steps


_NOT_MEASURED = (
    "Best methods, ranks and rows of other authors in tables 2.1 and 2.2 are not measured again. "
    f"Next to ours is {BASELINE_SETTINGS}."
)
_CHAPTER = load_chapter(2, _steps)
CHAPTER = replace(_CHAPTER, readings=(*_CHAPTER.readings, _NOT_MEASURED))
