"""Chapter 3 of the thesis: joint estimation and coding of pictures and disparities."""

import math
from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.picture_coders import Baseline, BaselineResult
from benchmarks.baselines.thesis_disparities import LaplacianCodec, laplacian_costs
from benchmarks.baselines.two_views import baselines_of
from benchmarks.thesis.harness import Method, Step, StepResult, Task, Value, load_chapter
from benchmarks.thesis.scenes import FREE_SCENES, REAL_SCENES, Scene, check_names
from benchmarks.thesis.view_curves import (
    ANCHOR,
    CODERS,
    PLAIN_QUADTREE,
    QUICK_BPP,
    REFERENCE_BPP,
    Coder,
    Curves,
    Point,
    curve,
    differences,
    layered_points,
    reference_multipliers,
    worst_loss,
)
from dvc.array_files import load_array, parse_disparities
from dvc.dibr.disparity.disparity_codec import all_significant, error_tensor
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.dibr.disparity.tree_optimisation import optimise_tree
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_set import Views, views_of_array
from dvc.dibr.view_stream import decode, decode_stream
from dvc.errors import ConfigError
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import warp_between
from dvc.web.drawing import Picture, colour_disparity, in_rows, with_title
from dvc.web.gallery import Table
from dvc.web.plotting import Line, line_plot

USUAL_SCENES, QUICK_SCENES = ("teddy", "tsukuba", "cones", "cgtoy"), ("teddy", "tsukuba")
USER_VIEWS = "views"
"""Name of the scene of the user's files."""
MIDDLE_BPP = 0.5
"""Rate of the reference view in figures of a single rate."""
NUM_LAYERS = 4
NUM_LEVELS = {"to one pixel": None, "5 levels": 5, "3 levels": 3}
"""Decompositions that are compared."""
LAYERED = "l", "s"
TITLES = {"l": "L", "s": "S", "blocks": "8x8 blocks"}
REFERENCE_RATES = 0.1, 0.5, 1.0
"""Rates of the reference view with a printed lambda, in bits per pixel."""
GAINS, LOSSES, SHARES, TEXT = "Figure 3.13", "Figure 3.14", "Figure 3.15", "Section 3.4"
LOSS = "{}: {}, largest loss by quality layers [dB]"
SHARE = "{}: {}, share of disparities at {:g} bpp [%]"
LAMBDA = "{}: lambda at {:g} bpp of the reference view"
RATE_LABEL, PSNR_LABEL = "rate [bits per pixel of the reference]", "PSNR by (3.1) [dB]"
ERROR_GAIN = 3
"""Gain of differences in figure 3.12."""
ERROR_QUANTILE, MATRIX_SCALE = 0.95, 3
"""Quantile of the errors that is white, and enlargement, in figure 3.4."""
PATH_COLOURS = (255, 120, 0), (40, 40, 255)
LEVELS = 0, 2, 4, 6
"""Resolutions of figure 3.9."""


class Measured(NamedTuple):
    """A scene and its lambdas, from large to small."""

    scene: Scene
    multipliers: list[float]
    middle: int  # index of the lambda for about `MIDDLE_BPP` of the reference


@cache
def load_scene(name: str, task: Task) -> Scene:
    """Load a scene of a task."""
    if name == USER_VIEWS:
        return Scene(load_array(task.chosen, None), parse_disparities(task.disparities or ""))
    load = FREE_SCENES[name] if name in FREE_SCENES else REAL_SCENES[name]
    assert task.data is not None or name in FREE_SCENES
    return load(task.data or task.folder)


@cache
def _measured(name: str, task: Task) -> Measured:
    scene, rates = load_scene(name, task), REFERENCE_BPP if task.full else QUICK_BPP
    return Measured(scene, reference_multipliers(scene.views, rates), rates.index(MIDDLE_BPP))


@cache
def _curve(name: str, task: Task, method: Method, coder: str) -> list[Point]:
    scene, multipliers, _ = _measured(name, task)
    return curve(scene.views, scene.labels, CODERS[method][coder], multipliers, method)


def _title(coder: str) -> str:
    return TITLES.get(coder, coder)


def _line(label: str, points: Sequence[Point]) -> Line:
    return Line(label, [point.rate_bpp for point in points], [point.quality.pooled_db for point in points])


def _error_paths(name: str, task: Task, _: Method) -> StepResult:
    """Draw figure 3.4: squared errors of the middle row, and its best disparities for two lambdas."""
    scene = load_scene(name, task)
    views, labels = scene.views, scene.labels
    row, reference = views.shape[0] // 2, views.references[0]
    rest = [index for index in range(len(views.pictures)) if index != reference]
    warps = [warp_between(views.viewpoints[reference], views.viewpoints[index]) for index in rest]
    disparities = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
    pictures = [views.pictures[index] / 255.0 for index in rest]
    tensor = error_tensor(views.pictures[reference] / 255.0, pictures, warps, disparities)[row : row + 1]
    shape = 1, tensor.shape[1]
    brightest = max(float(np.quantile(tensor, ERROR_QUANTILE)), 1e-9)
    levels = np.rint(255.0 * np.clip(tensor[0].T / brightest, 0.0, 1.0)).astype(np.uint8)[::-1]
    drawn = np.repeat(levels[:, :, None], 3, axis=2).repeat(MATRIX_SCALE, axis=0).repeat(MATRIX_SCALE, axis=1)
    for mu, colour in zip((0.0, 1e6), PATH_COLOURS, strict=True):
        tree, _errors = optimise_tree(L_TRANSFORM, tensor, laplacian_costs(shape, all_significant(shape), mu))
        path = (labels.num_labels - 1 - tree.disparity()[0]).astype(np.int64)
        corners = (np.stack([np.arange(shape[1]), path], axis=1) + 0.5) * MATRIX_SCALE
        cv2.polylines(drawn, [np.rint(corners).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
    title = f"row {row}; blue: lambda = 0, red: infinite"
    return StepResult(pictures={("3.4", name): with_title(np.ascontiguousarray(drawn), title)})


def _coders(name: str, task: Task, method: Method) -> StepResult:
    """Measure figures 3.9 to 3.13 and 3.15 on a scene."""
    scene, multipliers, middle = _measured(name, task)
    curves = {coder: _curve(name, task, method, coder) for coder in CODERS[method]}
    shown = sorted({0, middle, len(multipliers) - 1})
    some = [curves["l"][index] for index in shown]
    title = f"{name}, {len(scene.array)} views"
    rates = [_line(_title(coder), points) for coder, points in curves.items()]
    shares = [
        Line(_title(coder), [p.rate_bpp for p in curves[coder]], [100.0 * p.share for p in curves[coder]])
        for coder in LAYERED
    ]
    maps = "3.11" if name == "tsukuba" else "3.10"
    return StepResult(
        _values(name, curves),
        [_points_table(name, curves)],
        {
            ("3.9", name): _resolutions(scene, CODERS[method]["l"], multipliers[middle]),
            (maps, name): _disparity_maps(curves, shown, scene.labels),
            ("3.12", name): _rendered_views(scene.views, some, curves["l"][middle]),
        },
        {
            ("3.13", name): line_plot(rates, title, RATE_LABEL, PSNR_LABEL),
            ("3.15", name): line_plot(shares, title, RATE_LABEL, "share of disparities in the file [%]"),
        },
    )


def _values(name: str, curves: Curves) -> list[Value]:
    """Return gains of figure 3.13, shares of figure 3.15, and lambdas."""
    values = []
    for coder, points in curves.items():
        for anchor, label in ((ANCHOR, "quadtrees"), (PLAIN_QUADTREE, "quadtrees without credits")):
            if coder in (ANCHOR, anchor) or anchor not in curves:
                continue
            if (gain := differences(points, curves[anchor])) is not None:
                values.append(Value(GAINS, f"{name}: {_title(coder)} over {label} [dB]", gain[0], "+.2f"))
    for coder in LAYERED:
        for rate in REFERENCE_RATES:
            share = 100.0 * _nearest(curves[coder], rate).share
            values.append(Value(SHARES, SHARE.format(name, _title(coder), rate), share, ".1f"))
    for rate in REFERENCE_RATES:
        multiplier = _nearest(curves["l"], rate).multiplier
        values.append(Value(TEXT, LAMBDA.format(name, rate), multiplier, ".1e"))
    return values


def _nearest(points: Sequence[Point], reference_bpp: float) -> Point:
    """Return the point with the rate of its reference view nearest to a rate."""
    return min(points, key=lambda point: abs(math.log(point.reference_bpp / reference_bpp)))


def _points_table(name: str, curves: Curves) -> Table:
    """List all points of figure 3.13."""
    head = ("method", "lambda", "bytes", "rate [bpp]", PSNR_LABEL, "mean of PSNRs [dB]")
    rows = [
        (
            _title(coder),
            f"{point.multiplier:.2e}",
            str(point.num_bytes),
            *(f"{point.rate_bpp:.3f}", f"{point.quality.pooled_db:.2f}", f"{point.quality.mean_db:.2f}"),
        )
        for coder, points in curves.items()
        for point in points
    ]
    caption = f"{name}: whole files over pixels of the reference, all views rendered from the decoded file"
    return Table(f"{name}: points of figure 3.13", caption, head, tuple(rows))


def _coloured(disparity: NDArray[np.floating], labels: DisparityLabels) -> Picture:
    return colour_disparity(disparity, labels.lowest, labels.highest)


def _resolutions(scene: Scene, coder: Coder, multiplier: float) -> Picture:
    """Draw figure 3.9: picture and disparities at several resolutions, enlarged to one size."""
    encoded = ViewEncoder(scene.views, scene.labels, coder.kind, codec=coder.codec).encode(multiplier)
    stream = decode_stream(encoded.data)
    height, width = stream.header.shape
    tops, bottoms = [], []
    for level in LEVELS:
        if min(height, width) < 4 << level:
            break
        pair = decode(stream, resolution=level, codec=coder.codec).pairs[0]
        panels = pair.picture, _coloured(pair.disparity * 2.0**level, scene.labels)
        large = [
            np.asarray(cv2.resize(panel, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
            for panel in panels
        ]
        rows, columns = pair.picture.shape[:2]
        tops.append(with_title(large[0], f"level {level}: {columns}x{rows}"))
        bottoms.append(with_title(large[1], f"disparity, level {level}"))
    return in_rows([*tops, *bottoms], len(tops))


def _disparity_maps(curves: Curves, indices: Sequence[int], labels: DisparityLabels) -> Picture:
    """Draw figures 3.10 and 3.11: decoded references, and disparities of all coders, at several rates."""
    first = next(iter(curves.values()))
    panels = [
        with_title(first[index].pair.picture, f"reference, {first[index].reference_bpp:.2f} bpp")
        for index in indices
    ]
    for coder, points in curves.items():
        for point in (points[index] for index in indices):
            title = f"{_title(coder)}, {8.0 * point.disparity_bytes / point.num_pixels:.3f} bpp"
            panels.append(with_title(_coloured(point.pair.disparity, labels), title))
    return in_rows(panels, len(indices))


def _rendered_views(views: Views, points: Sequence[Point], middle: Point) -> Picture:
    """Draw figure 3.12: the view of the lowest PSNR, rendered at several rates, and its errors."""
    view = int(np.argmin(middle.quality.by_view_db))
    truth, tops, bottoms = views.pictures[view], [], []
    for point in points:
        title = f"{point.rate_bpp:.2f} bpp: {point.quality.by_view_db[view]:.2f} dB"
        tops.append(with_title(point.rendered[view], title))
        levels = 128.0 + ERROR_GAIN * (point.rendered[view].astype(np.float64) - truth)
        difference = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        bottoms.append(with_title(difference, f"difference, {ERROR_GAIN} times"))
    return in_rows([*tops, with_title(truth, "as the camera saw it"), *bottoms], len(points) + 1)


def _layers(name: str, task: Task, method: Method) -> StepResult:
    """Measure figure 3.14 on a scene."""
    scene, multipliers, _ = _measured(name, task)
    result, lines = StepResult(), []
    for coder in LAYERED:
        single, codec = _curve(name, task, method, coder), CODERS[method][coder]
        several = layered_points(scene.views, scene.labels, codec, multipliers[-1], NUM_LAYERS, method)
        loss, title = worst_loss(several, single), _title(coder)
        value = "no rates in common" if loss is None else loss
        result.values.append(Value(LOSSES, LOSS.format(name, title), value))
        lines += [_line(title, single), _line(f"{title}, {NUM_LAYERS} quality layers", several)]
    result.plots["3.14", name] = line_plot(lines, f"{name}: quality layers", RATE_LABEL, PSNR_LABEL)
    return result


def _decompositions(name: str, task: Task, method: Method) -> StepResult:
    """Compare a decomposition to one pixel with one that stops earlier, as image coding does."""
    scene, multipliers, middle = _measured(name, task)
    make = LaplacianCodec if method is Method.THESIS else WaveletCodec
    values, panels = [], []
    for label, num_levels in NUM_LEVELS.items():
        coder = Coder("l", make(L_TRANSFORM, num_levels))
        (point,) = curve(scene.views, scene.labels, coder, [multipliers[middle]], method)
        psnr_db = point.quality.pooled_db
        values.append(Value(TEXT, f"{name}: L, {label} [dB at {point.rate_bpp:.3f} bpp]", psnr_db))
        panel = _coloured(point.pair.disparity, scene.labels)
        panels.append(with_title(panel, f"{label}: {psnr_db:.2f} dB"))
    return StepResult(values, pictures={("3.9b", name): in_rows(panels, len(panels))})


def _baselines(name: str, task: Task, method: Method) -> StepResult:
    """Compare with other codecs in as many bytes, on the reference and one more view."""
    scene, multipliers, _ = _measured(name, task)
    views = views_of_array(scene.pair, gray=True)
    points = curve(views, scene.labels, CODERS[method]["l"], multipliers, method)
    results = {
        baseline.name: [_within(baseline, point.num_bytes) for point in points]
        for baseline in baselines_of(scene.pair, scene.labels)
    }
    return StepResult(tables=[_baselines_table(name, points, results)])


def _within(baseline: Baseline, max_bytes: int) -> BaselineResult | None:
    try:
        return baseline.best_within(max_bytes)
    except ConfigError:  # a library without its encoder, or a size that it does not code
        return None


def _baselines_table(
    name: str, points: Sequence[Point], results: Mapping[str, Sequence[BaselineResult | None]]
) -> Table:
    gain_label = "ours less this, mean [dB]"
    head = ("rate [bpp]", "codec", "bytes", PSNR_LABEL, "mean of PSNRs [dB]", gain_label, "second part [%]")
    rows: list[tuple[str, ...]] = []
    for index, point in enumerate(points):
        rate, ours = f"{point.rate_bpp:.3f}", point.quality
        cells = str(point.num_bytes), f"{ours.pooled_db:.2f}", f"{ours.mean_db:.2f}"
        rows.append((rate, "ours, L transform", *cells, "", f"{100.0 * point.share:.0f}"))
        for baseline, by_point in results.items():
            result = by_point[index]
            if result is None:
                rows.append((rate, baseline, "needs more", *("-",) * 4))
                continue
            _, mean_db, _ = result.quality
            cells = str(result.num_bytes), f"{result.quality.pooled_db:.2f}", f"{mean_db:.2f}"
            gain = f"{ours.mean_db - mean_db:+.2f}"
            rows.append((rate, baseline, *cells, gain, f"{100.0 * result.split:.0f}"))
    caption = (
        f"{name}, reference and one more view: the best result of each codec in at most as many bytes; "
        "second part: disparities, or the second view; P frames and two pictures give no further views"
    )
    return Table(f"{name}: other codecs", caption, head, tuple(rows), 2)


def _scene_names(task: Task) -> Sequence[str]:
    """Return the scenes of a task; named files make one."""
    if not task.chosen:
        return tuple(FREE_SCENES) if task.data is None else USUAL_SCENES if task.full else QUICK_SCENES
    if task.user_files:
        if task.disparities is None:
            raise ConfigError("views in files need --disparities MIN:MAX, in pixels per unit of m")
        return (USER_VIEWS,)
    check_names(task.chosen, task.data, tuple(REAL_SCENES), tuple(FREE_SCENES), ", or files of views")
    return task.chosen


def _steps(task: Task) -> list[Step]:
    steps = []
    for name in _scene_names(task):
        steps += [
            Step(f"paths-{name}", partial(_error_paths, name), (Method.THESIS,)),
            Step(f"methods-{name}", partial(_coders, name)),
            Step(f"layers-{name}", partial(_layers, name)),
            Step(f"decompositions-{name}", partial(_decompositions, name)),
        ]
        if task.full:
            steps.append(Step(f"baselines-{name}", partial(_baselines, name), (Method.DEFAULT,)))
    return steps


CHAPTER = load_chapter(3, _steps)
