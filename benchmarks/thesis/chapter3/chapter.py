"""Chapter 3 of the thesis: joint estimation and coding of pictures and disparities."""

import math
from collections.abc import Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from benchmarks.baselines.comparison import all_peers, within
from benchmarks.thesis.chapter import Chapter, Figure, Made, Step, Task, Value, Way
from benchmarks.thesis.chapter3 import pictures, tables
from benchmarks.thesis.chapter3.as_written import METHODS_BY_WAY, PLAIN_QUADTREE, READINGS, Method
from benchmarks.thesis.chapter3.curves import (
    Curves,
    Point,
    curve,
    differences,
    layered_points,
    reference_multipliers,
    worst_loss,
)
from benchmarks.thesis.chapter3.scenes import Scene, load_scene, scene_names
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM
from dvc.dibr.disparity.laplacian_codec import LaplacianCodec
from dvc.dibr.disparity.wavelet_codec import WaveletCodec
from dvc.dibr.views.encoder import ViewEncoder
from dvc.dibr.views.views import views_of_array
from dvc.web.plotting import Line, line_plot

REFERENCE_BPP, QUICK_BPP = (0.1, 0.25, 0.5, 0.75, 1.0), (0.1, 0.25, 0.5, 1.0)
"""Rates of the reference view that lambdas are chosen for."""
NUM_LAYERS = 4
EARLY_LEVELS = {"to one pixel": None, "5 levels": 5, "3 levels": 3}
LAYERED = "l", "s"
ANCHOR = "quadtree"
MIDDLE_BPP = 0.5
"""Where one rate is enough."""
GAINS, LOSSES, SHARES, TEXT = "Figure 3.13", "Figure 3.14", "Figure 3.15", "Section 3.4"
OVER_QUADTREES = "{}: {} over quadtrees [dB]"
LOSS = "{}: {}, largest loss by quality layers [dB]"
SHARE = "{}: {}, share of disparities at {:g} bpp [%]"
LAMBDA = "{}: lambda at {:g} bpp of the reference view"
RATE_LABEL, PSNR_LABEL = "rate [bits per pixel of the reference]", "PSNR by (3.1) [dB]"


class Measured(NamedTuple):
    """A scene and the lambdas that it is coded at, from large to small."""

    scene: Scene
    multipliers: list[float]
    middle: int  # number of the lambda at which the reference has about `MIDDLE_BPP`


@cache
def _scene(name: str, task: Task) -> Measured:
    scene = load_scene(name, task)
    rates = REFERENCE_BPP if task.full else QUICK_BPP
    return Measured(scene, reference_multipliers(scene.views, rates), rates.index(MIDDLE_BPP))


@cache
def _curve(name: str, task: Task, way: Way, method: str) -> list[Point]:
    measured = _scene(name, task)
    return curve(
        measured.scene.views, measured.scene.labels, METHODS_BY_WAY[way][method], measured.multipliers, way
    )


def _methods(name: str, task: Task, way: Way) -> Made:
    """Figures 3.9 to 3.13 and 3.15 of a scene."""
    measured = _scene(name, task)
    scene, made = measured.scene, Made()
    curves = {method: _curve(name, task, way, method) for method in METHODS_BY_WAY[way]}
    made.values = [*_gains(name, curves), *_shares(name, curves), *_lambdas(name, curves["l"])]
    made.tables.append(tables.points_table(name, curves))
    method = METHODS_BY_WAY[way]["l"]
    encoded = ViewEncoder(scene.views, scene.labels, method.kind, codec=method.codec).encode(
        measured.multipliers[measured.middle]
    )
    farthest = int(np.argmin(curves["l"][measured.middle].quality.by_view_db))
    shown = sorted({0, measured.middle, len(measured.multipliers) - 1})
    number = {"tsukuba": "3.11"}.get(name, "3.10")
    made.pictures = {
        ("3.9", name): pictures.resolution_levels(encoded, scene.labels, method.codec),
        (number, name): pictures.disparity_maps(curves, shown, scene.labels),
        ("3.12", name): pictures.rendered_panels(
            scene.views, [curves["l"][index] for index in shown], farthest
        ),
    }
    title = f"{name}, {len(scene.array)} views"
    rates = [_line(tables.title(method), points) for method, points in curves.items()]
    shares = [
        Line(
            tables.title(method),
            [point.rate_bpp for point in curves[method]],
            [100.0 * point.share for point in curves[method]],
        )
        for method in LAYERED
    ]
    made.plots = {
        ("3.13", name): line_plot(rates, title, RATE_LABEL, PSNR_LABEL),
        ("3.15", name): line_plot(shares, title, RATE_LABEL, "share of disparities in the file [%]"),
    }
    return made


def _gains(name: str, curves: Curves) -> list[Value]:
    values = []
    for method, points in curves.items():
        for anchor in (ANCHOR, PLAIN_QUADTREE):
            if method in (ANCHOR, anchor) or anchor not in curves:
                continue
            if (found := differences(points, curves[anchor])) is not None:
                over = f"{tables.title(method)} over {anchor}".replace(f"over {ANCHOR}", "over quadtrees", 1)
                values.append(Value(GAINS, f"{name}: {over} [dB]", found[0], "+.2f"))
    return values


def _shares(name: str, curves: Curves) -> list[Value]:
    return [
        Value(
            SHARES,
            SHARE.format(name, tables.title(method), rate),
            100.0 * _at(curves[method], rate).share,
            ".1f",
        )
        for method in LAYERED
        for rate in tables.THESIS_MULTIPLIERS
    ]


def _lambdas(name: str, points: Sequence[Point]) -> list[Value]:
    return [
        Value(TEXT, LAMBDA.format(name, rate), _at(points, rate).multiplier, ".1e")
        for rate in tables.THESIS_MULTIPLIERS
    ]


def _at(points: Sequence[Point], reference_bpp: float) -> Point:
    """Return the point whose reference view is nearest to a rate."""
    return min(points, key=lambda point: abs(math.log(point.reference_bpp / reference_bpp)))


def _line(label: str, points: Sequence[Point]) -> Line:
    return Line(label, [point.rate_bpp for point in points], [point.quality.pooled_db for point in points])


def _layers(name: str, task: Task, way: Way) -> Made:
    """Figure 3.14 of a scene."""
    measured = _scene(name, task)
    views, labels = measured.scene.views, measured.scene.labels
    made, lines = Made(), []
    for method in LAYERED:
        codec = METHODS_BY_WAY[way][method]
        single = _curve(name, task, way, method)
        several = layered_points(views, labels, codec, measured.multipliers[-1], NUM_LAYERS, way)
        loss = worst_loss(several, single)
        made.values.append(
            Value(
                LOSSES,
                LOSS.format(name, tables.title(method)),
                "no rates in common" if loss is None else loss,
            )
        )
        label = tables.title(method)
        lines += [_line(label, single), _line(f"{label}, {NUM_LAYERS} quality layers", several)]
    made.plots["3.14", name] = line_plot(lines, f"{name}: quality layers", RATE_LABEL, PSNR_LABEL)
    return made


def _decompositions(name: str, task: Task, way: Way) -> Made:
    """Decomposition to one pixel against stopping earlier, as image coding does."""
    measured = _scene(name, task)
    scene, found = measured.scene, {}
    make = LaplacianCodec if way is Way.THESIS else WaveletCodec
    for label, num_levels in EARLY_LEVELS.items():
        method = Method("l", make(L_TRANSFORM, num_levels))
        multiplier = measured.multipliers[measured.middle]
        (found[label],) = curve(scene.views, scene.labels, method, [multiplier], way)
    values = [
        Value(TEXT, f"{name}: L, {label} [dB at {point.rate_bpp:.3f} bpp]", point.quality.pooled_db)
        for label, point in found.items()
    ]
    return Made(values, pictures={("3.9b", name): pictures.decompositions(found, scene.labels)})


def _paths(name: str, task: Task, way: Way) -> Made:
    """Figure 3.4: errors of a row, and its disparities at both ends of lambda."""
    del way
    scene = load_scene(name, task)
    return Made(pictures={("3.4", name): pictures.error_matrix(scene)})


def _peers(name: str, task: Task, way: Way) -> Made:
    """What other codecs make of as many bytes, on the reference and one more view."""
    measured = _scene(name, task)
    scene = measured.scene
    views = views_of_array(scene.pair, gray=True)
    points = curve(views, scene.labels, METHODS_BY_WAY[way]["l"], measured.multipliers, way)
    peers = {
        peer: [within(code, point.num_bytes) for point in points]
        for peer, code in all_peers(scene.pair, scene.labels).items()
    }
    return Made(tables=[tables.peers_table(name, points, peers)])


def _steps(task: Task) -> list[Step]:
    steps = []
    for name in scene_names(task):
        steps += [
            Step(f"paths-{name}", partial(_paths, name), (Way.THESIS,)),
            Step(f"methods-{name}", partial(_methods, name)),
            Step(f"layers-{name}", partial(_layers, name)),
            Step(f"decompositions-{name}", partial(_decompositions, name)),
        ]
        if task.full:
            steps.append(Step(f"peers-{name}", partial(_peers, name), (Way.OURS,)))
    return steps


def _printed() -> dict[tuple[str, str], str]:
    printed: dict[tuple[str, str], str] = {}
    for scene, gains in tables.THESIS_GAINS_DB.items():
        for method, gain in gains.items():
            printed[GAINS, OVER_QUADTREES.format(scene, tables.title(method))] = f"{gain:+.2f}"
    for scene, losses in tables.THESIS_LAYER_LOSS_DB.items():
        for method, loss in losses.items():
            printed[LOSSES, LOSS.format(scene, tables.title(method))] = f"at most {loss:.2f}"
    for scene in tables.THESIS_GAINS_DB:
        for method in LAYERED:
            for rate in tables.THESIS_MULTIPLIERS:
                printed[SHARES, SHARE.format(scene, tables.title(method), rate)] = tables.THESIS_SHARES[rate]
        for rate, multiplier in tables.THESIS_MULTIPLIERS.items():
            printed[TEXT, LAMBDA.format(scene, rate)] = f"about {multiplier:.0e}"
    return printed


_DIAGRAM = "a diagram of the method"
CHAPTER = Chapter(
    3,
    "joint estimation and coding of depth-image-based representations",
    _printed(),
    (
        Figure("3.1", "overview of the codec", _DIAGRAM),
        Figure("3.2", "region of interest", _DIAGRAM),
        Figure("3.3", "planes of one depth in two views", _DIAGRAM),
        Figure("3.4", "errors of a row, and two optimal paths"),
        Figure("3.5", "dependencies of the L transform", _DIAGRAM),
        Figure("3.6", "dependencies of the S transform", _DIAGRAM),
        Figure("3.7", "divisions of the frequency plane", _DIAGRAM),
        Figure("3.8", "the sets of images", "photographs of others; in the folder of the sets"),
        Figure(
            "3.9",
            "disparities at four resolutions",
            "3.9b: decomposition stopped earlier, of which the text tells",
        ),
        Figure("3.10", "reference and disparities of all methods, Teddy"),
        Figure("3.11", "reference and disparities of all methods, Tsukuba"),
        Figure("3.12", "rendered views, and their errors"),
        Figure("3.13", "rate-distortion curves"),
        Figure("3.14", "quality layers"),
        Figure("3.15", "share of disparities"),
    ),
    READINGS,
    _steps,
)
