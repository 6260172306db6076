"""Chapter 4 of the thesis: joint coding by wavelets that stop at shared edges."""

from collections.abc import Mapping, Sequence
from functools import cache, partial

import numpy as np

from benchmarks.thesis.chapter import Chapter, Figure, Made, Step, Task, Value, Way
from benchmarks.thesis.chapter4 import pictures, tables
from benchmarks.thesis.chapter4.as_written import LINEAR, ORDERS, READINGS, fixed_edges
from benchmarks.thesis.chapter4.coefficients import high_bands
from benchmarks.thesis.chapter4.curves import (
    MapPoint,
    largest_gain,
    map_curve,
    map_point,
    picture_points,
    standard_point,
)
from benchmarks.thesis.chapter4.material import Material, load_material, material_names
from benchmarks.thesis.chapter4.signals import signal_bands
from dvc.errors import DvcError
from dvc.images.wavelets.edge_maps import EdgeMaps
from dvc.web.plotting import Line, line_plot

MAP_RATES = 0.02, 0.03, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.25
QUICK_MAP_RATES = 0.03, 0.04, 0.1, 0.2
"""Bits per pixel of whole files, as in figure 4.8a."""
PICTURE_RATES, QUICK_PICTURE_RATES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0), (0.1, 0.3, 0.75)
"""Bits of coefficients per pixel, as in figure 4.8b."""
MIDDLE_BPP = 0.04
"""Where one rate is enough, as in figures 4.6 and 4.7."""
STANDARD, SELECTED, PICTURE = "std9/7sym", "SA9/7lin, edges selected", "SA9/7sym"
MAPS, DECODED, IMAGES, TEXT = "Figure 4.8a", "Figure 4.7", "Figure 4.8b", "Section 4.6"
AT_MIDDLE = "{}: map at 0.04 bpp, {} [dB]"
LARGEST = "{}: largest gain of the {} [dB]"
EDGES = "{}: edges of the map [bpp]"
ENTROPY = "{}: entropy of high bands, {} [bpp]"


@cache
def _material(name: str, task: Task) -> Material:
    return load_material(name, task)


@cache
def _map_curves(name: str, task: Task, way: Way) -> dict[str, list[MapPoint]]:
    """Curves by transform; as written, all have the same edges."""
    material = _material(name, task)
    rates = MAP_RATES if task.full else QUICK_MAP_RATES
    curves = {STANDARD: map_curve(partial(standard_point, material), rates)}
    if way is Way.OURS:
        curves[SELECTED] = map_curve(partial(map_point, material), rates)
    else:
        edges = fixed_edges(material)
        for label, order in ORDERS.items():
            curves[label] = map_curve(partial(map_point, material, edges=edges, order=order), rates)
    if not all(curves.values()):
        raise DvcError(f"{name}: no file of at most {rates[-1]} bits a pixel holds so small a map")
    return curves


def _main(way: Way) -> str:
    """Name of the transform that the way stands for."""
    return LINEAR if way is Way.THESIS else SELECTED


def _middle(points: Sequence[MapPoint]) -> MapPoint:
    return min(points, key=lambda point: abs(point.rate_bpp - MIDDLE_BPP))


def _edges(name: str, task: Task, way: Way) -> EdgeMaps:
    return _middle(_map_curves(name, task, way)[_main(way)]).edges


def _maps(name: str, task: Task, way: Way) -> Made:
    """Figures 4.1, 4.6, 4.7 and 4.8a."""
    material, curves, main = _material(name, task), _map_curves(name, task, way), _main(way)
    middle = {label: _middle(points) for label, points in curves.items()}
    bands = {STANDARD: high_bands(material.depth), main: high_bands(material.depth, middle[main].edges)}
    made = Made(_map_values(name, curves, middle), [tables.map_table(name, curves)])
    made.values += [
        Value(TEXT, EDGES.format(name), middle[main].edges_bpp, ".4f"),
        *(
            Value("Figure 4.6", ENTROPY.format(name, _short(label)), found.entropy_bpp, ".3f")
            for label, found in bands.items()
        ),
    ]
    made.pictures = {
        ("4.1", name): pictures.input_data(material, middle[main].edges),
        ("4.6", name): pictures.coefficient_maps(bands, float(np.ptp(material.depth))),
        ("4.7", name): pictures.decoded_maps(material, {label: middle[label] for label in (STANDARD, main)}),
    }
    lines = [
        Line(label, [point.rate_bpp for point in points], [point.psnr_db for point in points])
        for label, points in curves.items()
    ]
    made.plots["4.8a", name] = line_plot(lines, f"{name}: map", "file [bits per pixel]", "PSNR [dB]")
    return made


def _map_values(
    name: str, curves: Mapping[str, Sequence[MapPoint]], middle: Mapping[str, MapPoint]
) -> list[Value]:
    decoded = [
        Value(DECODED, AT_MIDDLE.format(name, _short(label)), point.psnr_db)
        for label, point in middle.items()
    ]
    gains = [
        Value(MAPS, LARGEST.format(name, f"map, {_short(label)}"), largest_gain(points, curves[STANDARD]))
        for label, points in curves.items()
        if label != STANDARD
    ]
    return decoded + gains


def _short(label: str) -> str:
    """Name of a transform, however its edges are found."""
    return label.partition(",")[0]


def _picture(name: str, task: Task, way: Way) -> Made:
    """Figure 4.8b: as written with all edges, ours as the encoder writes it."""
    material = _material(name, task)
    assert material.picture is not None
    edges, rates = _edges(name, task, way), PICTURE_RATES if task.full else QUICK_PICTURE_RATES
    points = list(picture_points(material.picture, edges, rates))
    found = [point.shape_adaptive_db if way is Way.THESIS else point.chosen_db for point in points]
    standard = [point.standard_db for point in points]
    gain = max(one - other for one, other in zip(found, standard, strict=True))
    lines = [Line(STANDARD, rates, standard), Line(PICTURE, rates, found)]
    label = "coefficients [bits per pixel]"
    return Made(
        [Value(IMAGES, LARGEST.format(name, "picture"), gain)],
        [tables.picture_table(name, points)],
        plots={("4.8b", name): line_plot(lines, f"{name}: luma", label, "PSNR [dB]")},
    )


def _signal(task: Task, way: Way) -> Made:
    """Figure 4.3."""
    del task, way
    bands = signal_bands()
    return Made(tables=[tables.signal_table(bands)], plots={("4.3", ""): pictures.signal_plot(bands)})


def _steps(task: Task) -> list[Step]:
    steps = [Step("signal", _signal, (Way.THESIS,))]
    for name in material_names(task):
        steps.append(Step(f"map-{name}", partial(_maps, name)))
        if len(task.chosen) != 1 or not task.own:
            steps.append(Step(f"picture-{name}", partial(_picture, name)))
    return steps


_DIAGRAM = "a diagram of the method"
CHAPTER = Chapter(
    4,
    "joint coding by shape-adaptive wavelets",
    {
        (DECODED, AT_MIDDLE.format("teddy", STANDARD)): "36.21",
        (DECODED, AT_MIDDLE.format("teddy", LINEAR)): "39.86",
        (MAPS, LARGEST.format("teddy", f"map, {LINEAR}")): "5.46",
        (IMAGES, LARGEST.format("teddy", "picture")): "0.19",
        (TEXT, EDGES.format("teddy")): "0.015",
    },
    (
        Figure("4.1", "map and picture with the edges that both share"),
        Figure("4.2", "overview of the encoder", _DIAGRAM),
        Figure(
            "4.3", "a signal, and its high bands by both transforms", "the signal is made up: it is not given"
        ),
        Figure("4.4", "lifting steps", _DIAGRAM),
        Figure("4.5", "lattices of samples and edges", _DIAGRAM),
        Figure("4.6", "high-pass coefficients of the map"),
        Figure("4.7", "the decoded map"),
        Figure("4.8", "rate-distortion curves of map and picture"),
    ),
    READINGS,
    _steps,
)
