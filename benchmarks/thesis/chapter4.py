"""Chapter 4 of the thesis: joint coding by wavelets that stop at shared edges."""

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.harness import Method, Step, StepResult, Task, Value, load_chapter
from benchmarks.thesis.map_curves import (
    LINEAR,
    MAP_RATES,
    ORDERS,
    QUICK_MAP_RATES,
    MapPoint,
    Material,
    fixed_edges,
    largest_gain,
    map_curve,
    map_point,
    material_of_files,
    material_of_set,
    num_levels,
    picture_points,
    standard_point,
)
from benchmarks.thesis.scenes import MOTORCYCLE, PAIRS, check_names
from dvc.dibr.depth_image.depth_image_encoder import DepthOptions
from dvc.dibr.depth_image.depth_image_stream import Plane
from dvc.errors import ConfigError, DvcError
from dvc.images.edge_maps import EdgeMaps
from dvc.images.lifting import Transform
from dvc.web.drawing import Picture, colour_disparity, in_rows, with_title
from dvc.web.gallery import Table
from dvc.web.plotting import COLOURS, SUFFIXES, Line, contents, line_plot, new_figure

Samples = NDArray[np.float64]

USUAL_SETS = ("teddy",)
PICTURE_RATES, QUICK_PICTURE_RATES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0), (0.1, 0.3, 0.75)
"""Bits of coefficients per pixel, as in figure 4.8b."""
MIDDLE_BPP = 0.04
"""Rate of figures 4.6 and 4.7."""
STANDARD, SELECTED, PICTURE = "std9/7sym", "SA9/7lin, edges selected", "SA9/7sym"
MAPS, DECODED, IMAGES, TEXT = "Figure 4.8a", "Figure 4.7", "Figure 4.8b", "Section 4.6"
AT_MIDDLE = "{}: map at 0.04 bpp, {} [dB]"
LARGEST = "{}: largest gain of the {} [dB]"
EDGES = "{}: edges of the map [bpp]"
ENTROPY = "{}: entropy of high bands, {} [bpp]"
ENTROPY_STEP = 1 / 64
"""Step of the quantiser for the entropy, as a share of the range of the map."""
NUM_SAMPLES, NUM_LEVELS, CUBIC = 320, 5, 3
SIGNAL_EDGES = 79, 160, 241
"""Last sample before each edge of figure 4.3, odd and even ones."""
ENLARGED = 2
"""Enlargement of samples in figures with edges between them."""
EDGE_COLOUR = 40, 40, 255
"""Colour in blue, green and red."""
BRIGHTEST = 1 / 16
"""Magnitude of coefficients that is white, as a share of the range of a map."""


class SignalBands(NamedTuple):
    """A signal and its high bands, the finest first."""

    signal: Samples
    standard: list[Samples]  # bands of the 9/7 with symmetric extension
    shape_adaptive: list[Samples]  # bands with cubic extension at edges


def piecewise_signal() -> Samples:
    """Return a signal of constant, linear, cubic and again constant pieces."""
    t = np.linspace(0.0, 1.0, NUM_SAMPLES)
    pieces = (
        np.full_like(t, 0.25),
        0.9 - 1.4 * (t - 0.25),
        0.45 + 60.0 * (t - 0.53) * (t - 0.63) * (t - 0.73) * 4.0,
        np.full_like(t, 0.75),
    )
    before = [np.arange(NUM_SAMPLES) <= edge for edge in SIGNAL_EDGES]
    return np.asarray(np.select(before, pieces[:-1], pieces[-1]))


def signal_bands() -> SignalBands:
    """Transform the signal with and without its edges."""
    column = piecewise_signal()[:, np.newaxis]
    below = np.zeros(column.shape, np.uint8)
    below[list(SIGNAL_EDGES)] = 1
    edges = EdgeMaps(below, np.zeros_like(below))
    transforms = Transform(NUM_LEVELS), Transform(NUM_LEVELS, edges=edges, order=CUBIC)
    pyramids = [transform.analyse(column) for transform in transforms]
    standard, adaptive = ([band.vertical[:, 0] for band in pyramid.details] for pyramid in pyramids)
    return SignalBands(column[:, 0], standard, adaptive)


def _signal(_task: Task, _method: Method) -> StepResult:
    """Draw figure 4.3, and list its largest coefficients."""
    bands = signal_bands()
    rows = [
        (str(scale), f"{np.abs(standard).max():.3f}", f"{np.abs(adaptive).max():.1e}")
        for scale, (standard, adaptive) in enumerate(zip(*bands[1:], strict=True), 1)
    ]
    caption = (
        "Largest absolute coefficient of each high band, the finest first; the signal is from 0.25 to 0.9"
    )
    head = ("scale", "standard", "shape-adaptive, cubic")
    table = Table("Piecewise polynomials (figure 4.3)", caption, head, tuple(rows))
    return StepResult(tables=[table], plots={("4.3", ""): _signal_plot(bands)})


def _signal_plot(bands: SignalBands) -> dict[str, bytes]:
    num_bands = len(bands.standard)
    titles = "standard 9/7, symmetric extension", "shape-adaptive 9/7, cubic extension"
    largest = max(float(np.abs(band).max()) for band in (*bands.standard, *bands.shape_adaptive))
    with new_figure((9.0, 6.5)) as figure:
        grid = figure.add_gridspec(num_bands + 1, 2, height_ratios=[2.0] + [1.0] * num_bands)
        axes = figure.add_subplot(grid[0, :])
        axes.plot(bands.signal, ".", color=COLOURS[0], markersize=3)
        for edge in SIGNAL_EDGES:
            axes.axvline(edge + 0.5, color=COLOURS[1], linestyle="dashed", linewidth=1.0)
        axes.set_title("constant, linear and cubic pieces; dashed: edges", fontsize=10)
        for column, (title, side) in enumerate(zip(titles, bands[1:], strict=True)):
            for row, band in enumerate(side, 1):
                axes = figure.add_subplot(grid[row, column])
                positions = (2.0**row) * (np.arange(len(band)) + 0.5)
                axes.vlines(positions, 0.0, band, color=COLOURS[0], linewidth=1.2)
                axes.axhline(0.0, color="#999999", linewidth=0.6)
                axes.set_ylim(-1.1 * largest, 1.1 * largest)
                axes.set_xlim(0, len(bands.signal))
                axes.set_ylabel(f"j = {row}", fontsize=8)
                axes.tick_params(labelsize=7, labelbottom=row == num_bands)
                if row == 1:
                    axes.set_title(title, fontsize=10)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}


class HighBands(NamedTuple):
    """High bands of a map."""

    absolute: Plane  # magnitudes in the usual order of bands, the coarsest at the top left; low band 0
    entropy_bpp: float  # entropy of the quantised bands, each by itself, in bits per pixel of the map
    nonzero_share: float  # share of the coefficients that are not quantised to zero


def high_bands(depth: Plane, edges: EdgeMaps | None = None) -> HighBands:
    """Transform a map as the encoder does."""
    pyramid = Transform(num_levels(depth), DepthOptions.wavelet, edges, DepthOptions.order).analyse(depth)
    step, canvas = ENTROPY_STEP * float(np.ptp(depth)), np.zeros(depth.shape)
    bits, num_nonzero, num_high = 0.0, 0, 0
    for details in pyramid.details:
        for band in details:
            quantised = np.fix(band / step).astype(np.int64)
            _, counts = np.unique(quantised, return_counts=True)
            bits -= float(np.sum(counts * np.log2(counts / band.size)))
            num_nonzero += int(np.count_nonzero(quantised))
            num_high += band.size
        height, width = details.vertical.shape[0], details.horizontal.shape[1]
        rows, columns = details.horizontal.shape[0], details.vertical.shape[1]
        canvas[:rows, columns : columns + width] = np.abs(details.horizontal)
        canvas[rows : rows + height, :columns] = np.abs(details.vertical)
        canvas[rows : rows + height, columns : columns + width] = np.abs(details.diagonal)
    canvas[: pyramid.low.shape[0], : pyramid.low.shape[1]] = 0.0
    return HighBands(canvas, bits / depth.size, num_nonzero / max(num_high, 1))


@cache
def load_material(name: str, task: Task) -> Material:
    """Load a map of a task."""
    if task.user_files:
        return material_of_files(*task.chosen)
    assert task.data is not None or name == MOTORCYCLE
    return material_of_set(name, task.data or task.folder)


@cache
def _map_curves(name: str, task: Task, method: Method) -> dict[str, list[MapPoint]]:
    """Measure curves by transform; as written, all have the same edges."""
    material = load_material(name, task)
    rates = MAP_RATES if task.full else QUICK_MAP_RATES
    curves = {STANDARD: map_curve(partial(standard_point, material), rates)}
    if method is Method.DEFAULT:
        curves[SELECTED] = map_curve(partial(map_point, material), rates)
    else:
        edges = fixed_edges(material)
        for label, order in ORDERS.items():
            curves[label] = map_curve(partial(map_point, material, edges=edges, order=order), rates)
    if not all(curves.values()):
        raise DvcError(f"{name}: the map is too small for a file of {rates[-1]} bits per pixel")
    return curves


def _middle(points: Sequence[MapPoint]) -> MapPoint:
    return min(points, key=lambda point: abs(point.rate_bpp - MIDDLE_BPP))


def _shape_adaptive(method: Method) -> str:
    """Return the name of the transform that represents a method."""
    return LINEAR if method is Method.THESIS else SELECTED


def _short(label: str) -> str:
    """Return the name of a transform without its way to select edges."""
    return label.partition(",")[0]


def _maps(name: str, task: Task, method: Method) -> StepResult:
    """Measure figures 4.1, 4.6, 4.7 and 4.8a."""
    material, curves, adaptive = (
        load_material(name, task),
        _map_curves(name, task, method),
        _shape_adaptive(method),
    )
    middle = {label: _middle(points) for label, points in curves.items()}
    edges = middle[adaptive].edges
    bands = {STANDARD: high_bands(material.depth), adaptive: high_bands(material.depth, edges)}
    values = [
        Value(DECODED, AT_MIDDLE.format(name, _short(label)), point.psnr_db)
        for label, point in middle.items()
    ]
    for label, points in curves.items():
        if label != STANDARD:
            gain = largest_gain(points, curves[STANDARD])
            values.append(Value(MAPS, LARGEST.format(name, f"map, {_short(label)}"), gain))
    values.append(Value(TEXT, EDGES.format(name), middle[adaptive].edges_bpp, ".4f"))
    for label, band in bands.items():
        values.append(Value("Figure 4.6", ENTROPY.format(name, _short(label)), band.entropy_bpp, ".3f"))
    lines = [
        Line(label, [point.rate_bpp for point in points], [point.psnr_db for point in points])
        for label, points in curves.items()
    ]
    return StepResult(
        values,
        [_points_table(name, curves)],
        {
            ("4.1", name): _input_data(material, edges),
            ("4.6", name): _coefficients(bands, float(np.ptp(material.depth))),
            ("4.7", name): _decoded_maps(material, {label: middle[label] for label in bands}),
        },
        {("4.8a", name): line_plot(lines, f"{name}: map", "file [bits per pixel]", "PSNR [dB]")},
    )


def _points_table(name: str, curves: Mapping[str, Sequence[MapPoint]]) -> Table:
    rows = []
    for label, points in curves.items():
        for point in points:
            numbers = f"{point.rate_bpp:.4f}", f"{point.psnr_db:.2f}", f"{point.edges_bpp:.4f}"
            rows.append((label, *numbers, str(point.edges.count())))
    head = ("transform", "rate [bpp]", "PSNR [dB]", "edges [bpp]", "edges")
    title, caption = f"{name}: points of figure 4.8a", "Whole files, header and edges included"
    return Table(title, caption, head, tuple(rows))


def with_edges(picture: NDArray[np.uint8], edges: EdgeMaps) -> Picture:
    """Draw edges over an enlarged picture."""
    colour = np.repeat(picture[:, :, np.newaxis], 3, axis=2) if picture.ndim == 2 else picture
    large = colour.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
    for row, column in np.argwhere(edges.between_columns):
        large[ENLARGED * row : ENLARGED * (row + 1), ENLARGED * (column + 1) - 1] = EDGE_COLOUR
    for row, column in np.argwhere(edges.between_rows):
        large[ENLARGED * (row + 1) - 1, ENLARGED * column : ENLARGED * (column + 1)] = EDGE_COLOUR
    return large


def _coloured(depth: Plane, material: Material) -> Picture:
    return colour_disparity(depth, float(material.depth.min()), float(material.depth.max()))


def _input_data(material: Material, edges: EdgeMaps) -> Picture:
    """Draw figure 4.1: the map and the picture with shared edges."""
    label = f"depth map, {edges.count()} edges"
    panels = [with_title(with_edges(_coloured(material.depth, material), edges), label)]
    if material.picture is not None:
        panels.append(with_title(with_edges(material.picture, edges), "picture, the same edges"))
    return in_rows(panels, len(panels))


def _coefficients(bands: Mapping[str, HighBands], extent: float) -> Picture:
    """Draw figure 4.6: magnitudes of high-pass coefficients."""
    panels = []
    for name, band in bands.items():
        levels = np.rint(255.0 * np.clip(band.absolute / (BRIGHTEST * extent), 0.0, 1.0)).astype(np.uint8)
        panels.append(with_title(levels, f"{name}: {band.entropy_bpp:.3f} bits per pixel"))
    return in_rows(panels, len(panels))


def _decoded_maps(material: Material, points: Mapping[str, MapPoint]) -> Picture:
    """Draw figure 4.7: decoded maps, and below each of them its middle third, three times as large."""
    maps = {"original": material.depth}
    maps |= {f"{name}: {point.psnr_db:.2f} dB": point.depth for name, point in points.items()}
    tops, bottoms = [], []
    for label, depth in maps.items():
        picture = _coloured(depth, material)
        height, width = picture.shape[0], picture.shape[1]
        inner = picture[height // 3 : height - height // 3, width // 3 : width - width // 3]
        large = cv2.resize(inner, (width, height), interpolation=cv2.INTER_NEAREST)
        tops.append(with_title(picture, label))
        bottoms.append(np.asarray(large, np.uint8))
    return in_rows([*tops, *bottoms], len(maps))


def _picture(name: str, task: Task, method: Method) -> StepResult:
    """Measure figure 4.8b: as written with all edges, ours as the encoder writes it."""
    material, rates = load_material(name, task), PICTURE_RATES if task.full else QUICK_PICTURE_RATES
    assert material.picture is not None
    edges = _middle(_map_curves(name, task, method)[_shape_adaptive(method)]).edges
    points = list(picture_points(material.picture, edges, rates))
    psnrs = [point.shape_adaptive_db if method is Method.THESIS else point.chosen_db for point in points]
    standard = [point.standard_db for point in points]
    gain = max(psnr - other for psnr, other in zip(psnrs, standard, strict=True))
    rows = [
        (f"{p.rate_bpp:g}", f"{p.standard_db:.2f}", f"{p.shape_adaptive_db:.2f}", f"{p.chosen_db:.2f}")
        for p in points
    ]
    head = ("coefficients [bpp]", "no edges [dB]", "shared edges [dB]", "the better one [dB]")
    caption = "Luma at equal bits of coefficients, symmetric extension; edges count with the map"
    lines = [Line(STANDARD, rates, standard), Line(PICTURE, rates, psnrs)]
    plot = line_plot(lines, f"{name}: luma", "coefficients [bits per pixel]", "PSNR [dB]")
    return StepResult(
        [Value(IMAGES, LARGEST.format(name, "picture"), gain)],
        [Table(f"{name}: points of figure 4.8b", caption, head, tuple(rows))],
        plots={("4.8b", name): plot},
    )


def _names(task: Task) -> Sequence[str]:
    """Return the maps of a task; named files make one."""
    if task.user_files:
        if len(task.chosen) > 2:
            raise ConfigError(f"chapter 4 takes a map and its picture, got {len(task.chosen)} files")
        return (material_of_files(*task.chosen).name,)
    check_names(task.chosen, task.data, tuple(PAIRS), (MOTORCYCLE,), ", or a map")
    return task.chosen or ((MOTORCYCLE,) if task.data is None else USUAL_SETS)


def _steps(task: Task) -> list[Step]:
    steps = [Step("signal", _signal, (Method.THESIS,))]
    for name in _names(task):
        steps.append(Step(f"map-{name}", partial(_maps, name)))
        if len(task.chosen) != 1 or not task.user_files:
            steps.append(Step(f"picture-{name}", partial(_picture, name)))
    return steps


CHAPTER = load_chapter(4, _steps)
