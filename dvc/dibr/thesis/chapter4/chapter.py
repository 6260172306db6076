"""Chapter 4 of the thesis, measured again: one folder with tables, plots, pictures and a page of all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc import cli
from dvc.dibr.thesis.chapter4 import pictures, tables
from dvc.dibr.thesis.chapter4.coefficients import HighBands, high_bands
from dvc.dibr.thesis.chapter4.curves import (
    MAP_RATES,
    PICTURE_RATES,
    SHAPE_ADAPTIVE,
    STANDARD,
    TRANSFORMS,
    MapPoint,
    PicturePoint,
    largest_gain,
    map_curves,
    picture_points,
    rounded_psnr,
)
from dvc.dibr.thesis.chapter4.material import Material
from dvc.dibr.thesis.chapter4.signals import largest_high, signal_bands
from dvc.dibr.wavelets.edge_maps import EdgeMaps
from dvc.page.drawing import Picture
from dvc.page.gallery import Gallery, Group, Shown, Table, write_gallery
from dvc.page.plotting import Line, line_plot
from dvc.picture_files import write_png
from dvc.stereo.thesis.tables import markdown

DOCUMENT, VALUES, PAGE = "chapter4.md", "chapter4.json", "index.html"
SIGNAL_FIGURE = "4.3"
MIDDLE_BPP = 0.04
"""Where one rate is enough, as in figures 4.1, 4.6 and 4.7; the nearest one that there is."""
NOTES = (
    "Wavelet 9/7, five levels; the map's transform continues linearly at edges (order 1), the picture's "
    "symmetrically (order 0). Edges are selected by rate and distortion.",
    "Rates of maps are those of whole files, edges, header and checksum included. All pixels count, those of "
    "filled holes too; decoded maps are not rounded.",
)
FIGURE_TITLES = {
    "4.1": "Map and picture with the edges that both share",
    "4.6": "Absolute values of high-pass coefficients of the map",
    "4.7": "The decoded map at one rate, below it its middle, magnified",
    "4.8a": "Rate-distortion curves of the map",
    "4.8b": "Rate-distortion curves of the picture",
}


@dataclass
class MaterialResult:
    """What was measured on a map and its picture."""

    material: Material  # on what
    rates: list[float]  # of the map's points, as they were asked for
    curves: dict[str, list[MapPoint]]  # by transform
    picture_points: list[PicturePoint] = field(default_factory=list)  # none without a picture
    bands: dict[str, HighBands] = field(default_factory=dict)  # by transform

    @property
    def middle(self) -> int:
        """Number of the rate that is nearest to `MIDDLE_BPP`."""
        distances = [abs(rate - MIDDLE_BPP) for rate in self.rates]
        return distances.index(min(distances))

    @property
    def edges(self) -> EdgeMaps:
        """Of the shape-adaptive file of the middle rate."""
        return self.curves[SHAPE_ADAPTIVE][self.middle].edges

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers."""
        gain_db, rate_bpp = largest_gain(self.curves)
        return {
            "peak": self.material.peak,
            "map": {name: [point.to_dict() for point in points] for name, points in self.curves.items()},
            "largest_gain": {"db": rounded_psnr(gain_db), "bpp": rate_bpp},
            "picture": [
                {
                    "coefficients_bpp": point.rate_bpp,
                    "standard_db": rounded_psnr(point.standard_db),
                    "shape_adaptive_db": rounded_psnr(point.shape_adaptive_db),
                    "written_db": rounded_psnr(point.chosen_db),
                }
                for point in self.picture_points
            ],
            "coefficients": {
                name: {"entropy_bpp": found.entropy_bpp, "nonzero_share": found.nonzero_share}
                for name, found in self.bands.items()
            },
        }


def num_steps(num_rates: int | None = None) -> int:
    """Return how often `measure_material` advances."""
    return len(TRANSFORMS) * (num_rates or len(MAP_RATES)) + 1


def measure_material(
    material: Material,
    rates: Sequence[float] | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> MaterialResult:
    """Measure the chapter on a map and its picture."""
    chosen = sorted(rates or MAP_RATES)
    result = MaterialResult(material, chosen, map_curves(material, chosen, advance))
    edges = result.edges
    if material.picture is not None:
        result.picture_points = list(picture_points(material.picture, edges, PICTURE_RATES))
    result.bands = {
        STANDARD: high_bands(material.depth),
        SHAPE_ADAPTIVE: high_bands(material.depth, edges),
    }
    advance(1)
    return result


def _drawn(result: MaterialResult) -> dict[str, Picture]:
    middle = {name: points[result.middle] for name, points in result.curves.items()}
    return {
        "4.1": pictures.input_data(result.material, result.edges),
        "4.6": pictures.coefficient_maps(result.bands, float(np.ptp(result.material.depth))),
        "4.7": pictures.decoded_maps(result.material, middle),
    }


def _plotted(result: MaterialResult) -> dict[str, dict[str, bytes]]:
    name = result.material.name
    lines = [
        Line(label, [point.rate_bpp for point in points], [point.psnr_db for point in points])
        for label, points in result.curves.items()
    ]
    plots = {"4.8a": line_plot(lines, f"{name}: depth map", "rate of the file [bits per pixel]", "PSNR [dB]")}
    if points := result.picture_points:
        rates = [point.rate_bpp for point in points]
        found = [
            Line("no edges", rates, [point.standard_db for point in points]),
            Line("shared edges", rates, [point.shape_adaptive_db for point in points]),
        ]
        plots["4.8b"] = line_plot(found, f"{name}: luma", "coefficients [bits per pixel]", "PSNR [dB]")
    return plots


def all_tables(results: Sequence[MaterialResult]) -> list[Table]:
    """Make the tables of all maps."""
    found = []
    for one in results:
        found.append(tables.map_table(one.material.name, one.rates, one.curves))
        if one.picture_points:
            edges_bpp = one.curves[SHAPE_ADAPTIVE][one.middle].edges_bpp
            found.append(tables.picture_table(one.material.name, one.picture_points, edges_bpp))
    found.append(tables.entropy_table({one.material.name: one.bands for one in results}))
    return [*found, tables.signal_table(signal_bands())]


def write_chapter(folder: Path, results: Sequence[MaterialResult]) -> list[Table]:
    """Write tables, plots, pictures and numbers, and a page of them."""
    lines, groups, compared = [], [], []
    for one in results:
        drawn = _write_figures(folder, one)
        for number in sorted(drawn):
            title = f"{one.material.name}: {FIGURE_TITLES[number]}"
            lines.append(f"![{title}](figure-{number}-{one.material.name}.png)\n")
            groups.append(Group(f"{one.material.name}, figure {number}", (Shown(title, drawn[number]),)))
        compared.append(_compared(one))
    groups.append(_signal_group(folder, lines))
    found = all_tables(results)
    text = "\n".join(["# Chapter 4\n", *NOTES, "", *map(markdown, found), *lines])
    (folder / DOCUMENT).write_text(text, encoding="utf-8")
    cli.write_json(folder / VALUES, values(results))
    preface = "Tables and figures of chapter 4, measured again."
    gallery = Gallery("Shape-adaptive wavelets", preface, [*compared, *groups], found, NOTES)
    write_gallery(folder / PAGE, gallery)
    return found


def values(results: Sequence[MaterialResult]) -> dict[str, Any]:
    """Return all numbers."""
    bands = signal_bands()
    signal = {
        STANDARD: largest_high(bands.standard),
        SHAPE_ADAPTIVE: largest_high(bands.shape_adaptive),
    }
    return {"maps": {one.material.name: one.to_dict() for one in results}, "signal": signal}


def _write_figures(folder: Path, result: MaterialResult) -> dict[str, Picture]:
    """Write the figures of a map, and return them by number."""
    name = result.material.name
    drawn = _drawn(result)
    for number, picture in drawn.items():
        write_png(folder / f"figure-{number}-{name}.png", picture)
    for number, files in _plotted(result).items():
        for suffix, content in files.items():
            (folder / f"figure-{number}-{name}{suffix}").write_bytes(content)
        drawn[number] = _picture(files[".png"])
    return drawn


def _signal_group(folder: Path, lines: list[str]) -> Group:
    """Write figure 4.3, which is of no map."""
    title = "Signal of constant, linear and cubic pieces, and its high bands"
    files = pictures.signal_plot(signal_bands())
    for suffix, content in files.items():
        (folder / f"figure-{SIGNAL_FIGURE}{suffix}").write_bytes(content)
    lines.append(f"![{title}](figure-{SIGNAL_FIGURE}.png)\n")
    return Group(f"figure {SIGNAL_FIGURE}", (Shown(title, _picture(files[".png"])),))


def _compared(result: MaterialResult) -> Group:
    """The decoded maps of one rate, to be laid over each other."""
    material = result.material
    shown = [Shown("original", pictures.coloured(material.depth, material))]
    for name, points in result.curves.items():
        point = points[result.middle]
        label = f"{point.psnr_db:.2f} dB"
        shown.append(Shown(name, pictures.coloured(point.depth, material), label))
    return Group(f"{material.name}, maps at {result.rates[result.middle]:g} bits per pixel", tuple(shown))


def _picture(content: bytes) -> Picture:
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR), np.uint8)
