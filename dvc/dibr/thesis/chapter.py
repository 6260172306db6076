"""Chapter 3 of the thesis, measured again: one folder with tables, plots, pictures and a page of all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc import cli
from dvc.dibr.codec.encoder import ViewEncoder
from dvc.dibr.codec.views import views_of_array
from dvc.dibr.peers.comparison import all_peers, within
from dvc.dibr.peers.quality import PeerResult
from dvc.dibr.stream.header import DisparityMethod
from dvc.dibr.thesis import pictures, tables
from dvc.dibr.thesis.curves import Point, curve, differences, layered_points, measure, reference_multipliers
from dvc.dibr.thesis.decomposition import stopped_early
from dvc.dibr.thesis.scenes import Scene
from dvc.page.drawing import Picture
from dvc.page.gallery import Gallery, Group, Shown, Table, write_gallery
from dvc.page.plotting import Line, line_plot
from dvc.picture_files import write_png
from dvc.stereo.thesis.tables import markdown

DOCUMENT, VALUES, PAGE = "chapter3.md", "chapter3.json", "index.html"
REFERENCE_BPP = 0.1, 0.25, 0.5, 0.75, 1.0
"""Rates of the reference view that multipliers are chosen for."""
NUM_LAYERS = 4
EARLY_LEVELS = {"to one pixel": None, "5 levels": 5, "3 levels": 3}
LAYERED = DisparityMethod.L, DisparityMethod.S
MIDDLE_BPP = 0.5
"""Where one rate is enough."""
NOTES = (
    "Intensities are gray; PSNR is by (3.1): the squared error is pooled over all views, the reference "
    "included, rendered forward from the decoded file. Rates are bits of whole files over pixels of the "
    "reference.",
    f"Quality layers: {NUM_LAYERS}, multipliers in equal ratios.",
    "Other codecs may use as many bytes as our file has; all of their files count.",
)


@dataclass
class SceneResult:
    """What was measured on a scene."""

    scene: Scene  # what it was measured on
    multipliers: list[float]  # of the curves
    # by method: files of one layer; files cut after each layer
    curves: dict[str, list[Point]] = field(default_factory=dict)
    layered: dict[str, list[Point]] = field(default_factory=dict)
    decompositions: dict[str, Point] = field(default_factory=dict)  # by what was done
    pair_points: list[Point] = field(default_factory=list)  # files of the reference and one more view
    # what others made of as many bytes as each of these has
    peers: dict[str, list[PeerResult | None]] = field(default_factory=dict)
    figures: dict[str, Picture] = field(default_factory=dict)  # pictures by name
    plots: dict[str, dict[str, bytes]] = field(default_factory=dict)  # files by suffix, by name

    @property
    def middle(self) -> int:
        """Number of the point whose reference is nearest to `MIDDLE_BPP`."""
        rates = [abs(point.reference_bpp - MIDDLE_BPP) for point in self.curves["l"]]
        return rates.index(min(rates))

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers."""
        gains = {
            method: dict(zip(("bd_psnr_db", "bd_rate_percent"), found, strict=True))
            for method, points in self.curves.items()
            if (found := differences(points, self.curves[tables.ANCHOR])) is not None
        }
        return {
            "num_views": len(self.scene.array),
            "labels": list(self.scene.labels),
            "curves": {name: [point.to_dict() for point in points] for name, points in self.curves.items()},
            "against_quadtree": gains,
            "layered": {name: [point.to_dict() for point in points] for name, points in self.layered.items()},
            "decomposition": {label: point.to_dict() for label, point in self.decompositions.items()},
            "pair": [point.to_dict() for point in self.pair_points],
            "peers": {name: [_peer_dict(one) for one in found] for name, found in self.peers.items()},
        }


def _peer_dict(result: PeerResult | None) -> dict[str, Any] | None:
    if result is None:
        return None
    quality = result.quality
    return {
        "bytes": result.num_bytes,
        "psnr_pooled_db": quality.pooled_db,
        "psnr_mean_db": quality.mean_db,
        "second_part": result.split,
        "setting": result.setting,
    }


def num_steps(num_multipliers: int | None = None) -> int:
    """Return how often `measure_scene` advances."""
    count = num_multipliers or len(REFERENCE_BPP)
    return len(DisparityMethod) * count + len(LAYERED) + len(EARLY_LEVELS) + 2


def measure_scene(
    scene: Scene,
    multipliers: Sequence[float] | None = None,
    with_peers: bool = True,
    advance: Callable[[int], None] = lambda _: None,
) -> SceneResult:
    """Measure the chapter on a scene."""
    views, labels = scene.views, scene.labels
    chosen = sorted(multipliers or reference_multipliers(views, REFERENCE_BPP), reverse=True)
    result = SceneResult(scene, chosen)
    for method in DisparityMethod:
        result.curves[method.name.lower()] = curve(views, labels, method, chosen, advance)
    for method in LAYERED:
        points = layered_points(views, labels, method, chosen[-1], NUM_LAYERS)
        result.layered[method.name.lower()] = points
        advance(1)
    multiplier = chosen[result.middle]
    for label, num_levels in EARLY_LEVELS.items():
        result.decompositions[label] = stopped_early(views, labels, multiplier, num_levels)
        advance(1)
    if with_peers:
        _measure_peers(result)
    advance(1)
    _draw(result)
    advance(1)
    return result


def _shown(result: SceneResult) -> list[int]:
    """Numbers of the points that pictures show: the first, the middle one and the last."""
    return sorted({0, result.middle, len(result.multipliers) - 1})


def _measure_peers(result: SceneResult) -> None:
    pair, labels = result.scene.pair, result.scene.labels
    shown = [result.multipliers[index] for index in _shown(result)]
    if len(result.scene.array) > 2:
        views = views_of_array(pair, gray=True)
        result.pair_points = curve(views, labels, DisparityMethod.L, shown)
    else:
        result.pair_points = [result.curves["l"][index] for index in _shown(result)]
    for name, peer in all_peers(pair, labels).items():
        result.peers[name] = [within(peer, point.num_bytes) for point in result.pair_points]


def _draw(result: SceneResult) -> None:
    scene, views = result.scene, result.scene.views
    encoded = ViewEncoder(views, scene.labels).encode(result.multipliers[result.middle])
    farthest = int(np.argmin(measure(views, encoded).quality.by_view_db))
    shown = _shown(result)
    result.figures = {
        "3.9": pictures.resolution_levels(encoded, scene.labels),
        "3.10": pictures.disparity_maps(result.curves, shown, scene.labels),
        "3.12": pictures.rendered_panels(views, [result.curves["l"][index] for index in shown], farthest),
        "decomposition": pictures.decompositions(result.decompositions, scene.labels),
    }
    result.plots = {
        "3.13": _rate_distortion(result),
        "3.14": _layers(result),
        "3.15": _shares(result),
    }


def _line(label: str, points: Sequence[Point]) -> Line:
    return Line(label, [point.rate_bpp for point in points], [point.quality.pooled_db for point in points])


def _rate_distortion(result: SceneResult) -> dict[str, bytes]:
    lines = [_line(tables.TITLES[method], points) for method, points in result.curves.items()]
    title = f"{result.scene.name}, {len(result.scene.array)} views"
    return line_plot(lines, title, "rate [bits per pixel of the reference]", "PSNR by (3.1) [dB]")


def _layers(result: SceneResult) -> dict[str, bytes]:
    lines = []
    for method, points in result.layered.items():
        label = tables.TITLES[method]
        lines += [_line(label, result.curves[method]), _line(f"{label}, {NUM_LAYERS} quality layers", points)]
    title = f"{result.scene.name}: quality layers"
    return line_plot(lines, title, "rate [bits per pixel of the reference]", "PSNR by (3.1) [dB]")


def _shares(result: SceneResult) -> dict[str, bytes]:
    lines = [
        Line(
            tables.TITLES[method],
            [point.rate_bpp for point in points],
            [100.0 * point.share for point in points],
        )
        for method, points in result.curves.items()
        if method in result.layered
    ]
    title = f"{result.scene.name}: share of the disparities"
    return line_plot(lines, title, "rate [bits per pixel of the reference]", "share of the file [%]")


FIGURE_TITLES = {
    "3.9": "Picture and disparities at several resolutions",
    "3.10": "Disparities of all methods at three multipliers (figures 3.10 and 3.11)",
    "3.12": "The view that is predicted worst, and its differences",
    "3.13": "Rate-distortion curves",
    "3.14": "Quality layers against files without",
    "3.15": "Share of the disparities in the file",
    "decomposition": "Decomposition to one pixel, or stopped earlier",
}


def all_tables(results: Sequence[SceneResult]) -> list[Table]:
    """Make the tables of all scenes."""
    curves = {one.scene.name: one.curves for one in results}
    found = [
        tables.gains_table(curves),
        tables.layers_table(curves, {one.scene.name: one.layered for one in results}),
        tables.share_table(curves),
        tables.decomposition_table({one.scene.name: one.decompositions for one in results}),
    ]
    for one in results:
        if one.peers:
            found.append(tables.peers_table(one.scene.name, one.pair_points, one.peers))
    return found + [tables.points_table(one.scene.name, one.curves) for one in results]


def write_chapter(folder: Path, results: Sequence[SceneResult]) -> list[Table]:
    """Write tables, plots, pictures and numbers, and a page of them."""
    lines, groups = [], []
    for one in results:
        drawn = dict(one.figures)
        for name, files in one.plots.items():
            for suffix, content in files.items():
                (folder / f"figure-{name}-{one.scene.name}{suffix}").write_bytes(content)
            drawn[name] = _picture(files[".png"])
        for name, picture in one.figures.items():
            write_png(folder / f"figure-{name}-{one.scene.name}.png", picture)
        for name in sorted(drawn, key=list(FIGURE_TITLES).index):
            title = f"{one.scene.name}: {FIGURE_TITLES[name]}"
            lines.append(f"![{title}](figure-{name}-{one.scene.name}.png)\n")
            groups.append(Group(f"{one.scene.name}, figure {name}", (Shown(title, drawn[name]),)))
    found = all_tables(results)
    text = "\n".join(["# Chapter 3\n", *NOTES, "", *map(markdown, found), *lines])
    (folder / DOCUMENT).write_text(text, encoding="utf-8")
    cli.write_json(folder / VALUES, {one.scene.name: one.to_dict() for one in results})
    preface = "Tables and figures of chapter 3, measured again."
    compared = [group for one in results for group in _compared(one)]
    write_gallery(
        folder / PAGE,
        Gallery("Joint coding of pictures and disparities", preface, [*compared, *groups], found, NOTES),
    )
    return found


def _compared(result: SceneResult) -> list[Group]:
    """Disparities of one rate, to be laid over each other."""
    shown = [
        Shown(
            tables.TITLES[method],
            pictures.coloured(points[result.middle].pair.disparity, result.scene.labels),
            f"{points[result.middle].quality.pooled_db:.2f} dB",
        )
        for method, points in result.curves.items()
    ]
    reference = Shown("reference, decoded", result.curves["l"][result.middle].pair.picture)
    return [Group(f"{result.scene.name}, disparities", (reference, *shown))]


def _picture(content: bytes) -> Picture:
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR), np.uint8)
