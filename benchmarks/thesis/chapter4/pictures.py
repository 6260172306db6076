"""Figures 4.1, 4.3, 4.6 and 4.7 as pictures."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.chapter4.coefficients import HighBands
from benchmarks.thesis.chapter4.curves import MapPoint
from benchmarks.thesis.chapter4.material import Material
from benchmarks.thesis.chapter4.signals import EDGES, SignalBands
from dvc.dibr.depth_image.depth_scale import Plane
from dvc.images.wavelets.edge_maps import EdgeMaps
from dvc.web.drawing import Picture, colour_disparity, in_rows, with_title
from dvc.web.plotting import COLOURS, SUFFIXES, contents, new_figure

ENLARGED = 2
"""Samples are drawn so many times as large where edges run between them."""

EDGE_COLOUR = 40, 40, 255
"""Blue, green and red."""

BRIGHTEST = 1 / 16
"""Coefficients of so many parts of the range of a map, and larger ones, are drawn white."""


def with_edges(picture: NDArray[np.uint8], edges: EdgeMaps) -> Picture:
    """Draw edges over a picture, enlarged."""
    colour = np.repeat(picture[:, :, np.newaxis], 3, axis=2) if picture.ndim == 2 else picture
    large = colour.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
    marked = np.zeros(large.shape[:2], np.bool_)
    for row, column in np.argwhere(edges.between_columns):
        marked[ENLARGED * row : ENLARGED * (row + 1), ENLARGED * (column + 1) - 1] = True
    for row, column in np.argwhere(edges.between_rows):
        marked[ENLARGED * (row + 1) - 1, ENLARGED * column : ENLARGED * (column + 1)] = True
    large[marked] = EDGE_COLOUR
    return large


def coloured(depth: Plane, material: Material) -> Picture:
    """Colour a map by the range of what was coded."""
    return colour_disparity(depth, float(material.depth.min()), float(material.depth.max()))


def input_data(material: Material, edges: EdgeMaps) -> Picture:
    """Draw figure 4.1: the map and the picture with shared edges."""
    label = f"depth map, {edges.count()} edges"
    panels = [with_title(with_edges(coloured(material.depth, material), edges), label)]
    if material.picture is not None:
        panels.append(with_title(with_edges(material.picture, edges), "picture, the same edges"))
    return in_rows(panels, len(panels))


def coefficient_maps(bands: Mapping[str, HighBands], extent: float) -> Picture:
    """Draw figure 4.6: absolute values of high-pass coefficients."""
    panels = []
    for name, found in bands.items():
        bright = np.clip(found.absolute / (BRIGHTEST * extent), 0.0, 1.0)
        levels = np.rint(255.0 * bright).astype(np.uint8)
        panels.append(with_title(levels, f"{name}: {found.entropy_bpp:.3f} bits per pixel"))
    return in_rows(panels, len(panels))


def decoded_maps(material: Material, points: Mapping[str, MapPoint]) -> Picture:
    """Draw figure 4.7: decoded maps, and below each its magnified middle."""
    maps = {"original": material.depth}
    maps |= {f"{name}: {point.psnr_db:.2f} dB": point.depth for name, point in points.items()}
    tops = [with_title(coloured(depth, material), label) for label, depth in maps.items()]
    bottoms = [_middle(coloured(depth, material)) for depth in maps.values()]
    return in_rows([*tops, *bottoms], len(maps))


def _middle(picture: Picture) -> Picture:
    """The middle third of a picture, three times as large."""
    height, width = picture.shape[0], picture.shape[1]
    inner = picture[height // 3 : height - height // 3, width // 3 : width - width // 3]
    return np.asarray(cv2.resize(inner, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)


def signal_plot(bands: SignalBands) -> dict[str, bytes]:
    """Draw figure 4.3: the signal with its edges, and its high bands by both transforms."""
    with new_figure((9.0, 6.5)) as figure:
        grid = figure.add_gridspec(
            len(bands.standard) + 1, 2, height_ratios=[2.0] + [1.0] * len(bands.standard)
        )
        axes = figure.add_subplot(grid[0, :])
        axes.plot(bands.signal, ".", color=COLOURS[0], markersize=3)
        for edge in EDGES:
            axes.axvline(edge + 0.5, color=COLOURS[1], linestyle="dashed", linewidth=1.0)
        axes.set_title("constant, linear and cubic pieces; dashed: edges", fontsize=10)
        titles = "standard 9/7, symmetric extension", "shape-adaptive 9/7, cubic extension"
        largest = max(float(np.abs(band).max()) for band in (*bands.standard, *bands.shape_adaptive))
        for column, (title, found) in enumerate(zip(titles, bands[1:], strict=True)):
            for row, band in enumerate(found, 1):
                axes = figure.add_subplot(grid[row, column])
                places = (2.0**row) * (np.arange(len(band)) + 0.5)
                axes.vlines(places, 0.0, band, color=COLOURS[0], linewidth=1.2)
                axes.axhline(0.0, color="#999999", linewidth=0.6)
                axes.set_ylim(-1.1 * largest, 1.1 * largest)
                axes.set_xlim(0, len(bands.signal))
                axes.set_ylabel(f"j = {row}", fontsize=8)
                axes.tick_params(labelsize=7, labelbottom=row == len(found))
                if row == 1:
                    axes.set_title(title, fontsize=10)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}
