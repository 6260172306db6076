"""Chapter 2 of the thesis, measured again: one folder with tables, figures and a page of both."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc import cli
from dvc.errors import DvcError
from dvc.multiview.camera_array import CameraArray, DisparityLabels
from dvc.page.drawing import Picture, colour_disparity, in_rows, with_title
from dvc.page.gallery import Gallery, Group, Shown, Table, write_gallery
from dvc.picture_files import write_png
from dvc.stereo.evaluation import read_mask
from dvc.stereo.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.stereo.layers.sprites import extract_sprites
from dvc.stereo.output.layer_pictures import draw_layers, draw_sprites, draw_surfaces, draw_values_per_pixel
from dvc.stereo.rectification.rectified_folder import preview
from dvc.stereo.surfaces.reconstruction import reconstruct
from dvc.stereo.surfaces.settings import StereoSettings
from dvc.stereo.surfaces.surface import Reconstruction
from dvc.stereo.thesis import pictures
from dvc.stereo.thesis.opencv_baseline import BASELINE as BASELINE_SETTINGS
from dvc.stereo.thesis.opencv_baseline import semi_global_baseline
from dvc.stereo.thesis.real_sets import PAIRS, TSUKUBA, RealSet
from dvc.stereo.thesis.tables import (
    BASELINE,
    CAMERAS,
    OURS,
    OURS_RAW,
    Percent,
    markdown,
    table_2_1,
    table_2_2,
    table_2_3,
)
from dvc.stereo.thesis.toy import rectified_toy
from dvc.stereo.thesis.two_planes import LABELS, two_planes

DOCUMENT, VALUES, PAGE = "chapter2.md", "chapter2.json", "index.html"
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
TITLES = {
    "2.2": "The toy array after rectification: rows and columns agree",
    "2.4": "Two planes and three cameras: what one iteration and two iterations find",
    "2.5": "Tsukuba, cross of five cameras, squared difference: occlusion models",
    "2.6": "Layered depth image of Tsukuba with 25 cameras",
    "2.7": "Largest sprites of Tsukuba with 25 cameras",
    "2.8": "Disparities of the toy array",
    "2.9": "Two cameras: reference view, truth, disparity, errors",
    "2.10": "Values per pixel of Tsukuba's layered depth images",
    "2.11": "Texture of what stands on the table of Tsukuba",
}


@dataclass
class Chapter:
    """What is made of the chapter, step by step."""

    data: Path  # folder of the real sets
    jobs: int = 1  # processor cores that may be used
    tables: list[Table] = field(default_factory=list)  # tables of the thesis
    figures: dict[str, Picture] = field(default_factory=dict)  # pictures by number of the figure
    groups: list[Group] = field(default_factory=list)  # pictures of the pairs, to be compared
    values: dict[str, Any] = field(default_factory=dict)  # numbers behind the tables, JSON-safe

    def surfaces(
        self, array: CameraArray, labels: DisparityLabels, settings: StereoSettings | None = None
    ) -> Reconstruction:
        """Reconstruct."""
        return reconstruct(array, labels, settings or StereoSettings(), jobs=self.jobs)


def reproduce(
    data: Path, folder: Path, jobs: int = 1, advance: Callable[[int], None] = lambda _: None
) -> list[Table]:
    """Measure the tables and draw the figures of chapter 2."""
    chapter = Chapter(data, jobs)
    for step in STEPS:
        step(chapter)
        advance(1)
    write_chapter(folder, chapter)
    return chapter.tables


def write_chapter(folder: Path, chapter: Chapter) -> None:
    """Write tables, figures and numbers, and a page of them."""
    for number, picture in chapter.figures.items():
        write_png(folder / f"figure-{number}.png", picture)
    lines = [f"The baseline is {BASELINE_SETTINGS}.\n", *map(markdown, chapter.tables)]
    lines += [f"![{TITLES[number]}](figure-{number}.png)\n" for number in sorted(chapter.figures, key=_order)]
    (folder / DOCUMENT).write_text("# Chapter 2\n\n" + "\n".join(lines), encoding="utf-8")
    cli.write_json(folder / VALUES, chapter.values)
    groups = [
        Group(f"Figure {number}", (Shown(TITLES[number], chapter.figures[number]),))
        for number in sorted(chapter.figures, key=_order)
    ]
    preface = f"Tables and figures of chapter 2, measured again. The baseline is {BASELINE_SETTINGS}."
    write_gallery(
        folder / PAGE,
        Gallery("Stereo from planar camera arrays", preface, [*chapter.groups, *groups], chapter.tables),
    )


def _order(number: str) -> int:
    return int(number.split(".")[1])


def _two_planes(chapter: Chapter) -> None:
    """Figure 2.4."""
    array, truth = two_planes()
    found = {
        iterations: chapter.surfaces(array, LABELS, StereoSettings(max_iterations=iterations))
        for iterations in ITERATIONS
    }
    chapter.figures["2.4"] = pictures.figure_2_4(truth, found)


def _toy(chapter: Chapter) -> None:
    """Figures 2.2 and 2.8."""
    rectified = rectified_toy()
    array, labels = rectified.array, rectified.labels
    if labels is None:
        raise DvcError("toy: no disparities were found")
    found = chapter.surfaces(array, labels)
    chapter.figures["2.2"] = preview(array)
    maps = [
        with_title(colour_disparity(surface.disparity, labels.lowest, labels.highest), view.name)
        for view, surface in zip(array, found.surfaces, strict=True)
    ]
    chapter.figures["2.8"] = in_rows(maps, 2)


def _occlusion_models(chapter: Chapter) -> None:
    """Figure 2.5."""
    array, truth = TSUKUBA.array(chapter.data, 5), TSUKUBA.true_disparity(chapter.data)
    mask = read_mask(chapter.data / TSUKUBA.name / "all.png")
    panels, bad = [], {}
    for model, title in OCCLUSION_MODELS.items():
        found = chapter.surfaces(array, TSUKUBA.labels, StereoSettings(cost="squared", occlusion=model))
        disparity = found.surfaces[array.reference].disparity
        panels += pictures.disparity_panels(disparity[CROP], truth[CROP], TSUKUBA.labels, title, mask[CROP])
        bad[model] = _bad(chapter, TSUKUBA, disparity)
    chapter.figures["2.5"] = in_rows(panels[::2] + panels[1::2], len(OCCLUSION_MODELS))
    chapter.values["figure_2_5_bad_percent"] = bad


def _pairs(chapter: Chapter) -> None:
    """Table 2.1 and figure 2.9."""
    measured: dict[str, dict[str, Percent]] = {OURS: {}, OURS_RAW: {}, BASELINE: {}}
    panels = []
    for name, one in PAIRS.items():
        array, truth = one.pair(chapter.data), one.true_disparity(chapter.data)
        disparity = chapter.surfaces(array, one.labels).surfaces[0].disparity
        raw = chapter.surfaces(array, one.labels, StereoSettings(cost="squared")).surfaces[0].disparity
        baseline = semi_global_baseline(array[0].image, array[1].image, one.labels.highest)
        methods: dict[str, NDArray[np.floating]] = {OURS: disparity, OURS_RAW: raw, BASELINE: baseline}
        for method, found in methods.items():
            measured[method][name] = _bad(chapter, one, found)
        mask = read_mask(chapter.data / name / "all.png")
        chapter.groups.append(pictures.pair_group(name, array[0], truth, mask, one.labels, methods))
        known = with_title(colour_disparity(truth, one.labels.lowest, one.labels.highest), "truth")
        panels += [pictures.view_panel(array[0]), known]
        panels += pictures.disparity_panels(disparity, truth, one.labels, name, mask)
    chapter.figures["2.9"] = in_rows(panels, 4)
    chapter.tables.append(table_2_1(measured))
    chapter.values["table_2_1_bad_percent"] = measured


def _cameras(chapter: Chapter) -> None:
    """Tables 2.2 and 2.3, figures 2.6, 2.7, 2.10 and 2.11."""
    images: dict[int, LayeredDepthImage] = {}
    bad = {}
    for cameras in CAMERAS:
        array = TSUKUBA.array(chapter.data, cameras)
        found = chapter.surfaces(array, TSUKUBA.labels)
        bad[cameras] = _bad(chapter, TSUKUBA, found.surfaces[array.reference].disparity)
        images[cameras] = layered_depth_image(found)
    counts = {cameras: image.counts() for cameras, image in images.items()}
    numbers = {
        cameras: (count["num_values_inside"], count["num_values_beyond"], count["num_layers"])
        for cameras, count in counts.items()
    }
    frame = images[CAMERAS[0]].canvas.frame
    chapter.tables += [table_2_2(bad), table_2_3(frame.width * frame.height, numbers)]
    chapter.values["table_2_2_bad_percent"] = {str(cameras): values for cameras, values in bad.items()}
    chapter.values["table_2_3"] = {str(cameras): count for cameras, count in counts.items()}
    most = images[max(CAMERAS)]
    chapter.figures["2.6"] = draw_layers(most)
    chapter.figures["2.7"] = draw_sprites(extract_sprites(most), 12, 3)
    counted = {cameras: draw_values_per_pixel(image) for cameras, image in images.items()}
    behind = {cameras: draw_surfaces(image, *ON_THE_TABLE_PX, TABLE) for cameras, image in images.items()}
    for number, drawn in (("2.10", counted), ("2.11", behind)):
        titled = [with_title(picture, f"{cameras} cameras") for cameras, picture in drawn.items()]
        chapter.figures[number] = in_rows(titled, len(titled))


def _bad(chapter: Chapter, one: RealSet, disparity: NDArray[np.floating]) -> dict[str, float]:
    """Return bad pixels beyond 1 px in per cent, by mask."""
    found = one.evaluate(chapter.data, disparity)
    return {mask: result.bad_percent[1.0] for mask, result in found.items()}


STEPS: tuple[Callable[[Chapter], None], ...] = (_two_planes, _toy, _occlusion_models, _pairs, _cameras)
"""In the order of the chapter."""
