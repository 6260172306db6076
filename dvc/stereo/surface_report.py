"""Report of a reconstruction: figures, warnings, previews, and a page of them."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvc.arrays import Floats, Mask
from dvc.errors import ConfigError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, Reconstruction, Surface
from dvc.picture_files import write_png
from dvc.stereo.evaluation import disparity_error, evaluate
from dvc.web.drawing import colour_disparity, colour_error, disparity_legend
from dvc.web.gallery import Gallery, Group, Shown, Table, write_gallery

PAGE = "index.html"
MAX_AT_AN_END_PERCENT = 20.0
"""Largest share of pixels at the first or the last disparity without a warning."""
THRESHOLDS_PX = (0.5, 1.0, 2.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """True disparities of the reference view."""

    disparity: Floats  # in pixels per unit of m; NaN if unknown
    mask: Mask | None = None  # pixels that count; None: all


def check_views(array: CameraArray, labels: DisparityLabels) -> list[str]:
    """Refuse views without texture; return warnings for identical ones."""
    for view in array:
        if (view.image == view.image[:1, :1]).all():
            raise ConfigError(f"view {view.name} has a single colour: it has nothing to match")
    warnings = []
    seen: dict[bytes, str] = {}
    for view in array:
        twin = seen.setdefault(view.image.tobytes(), view.name)
        if twin == view.name:
            continue
        message = f"views {twin} and {view.name} are identical"
        if not labels.lowest <= 0.0 <= labels.highest:
            raise ConfigError(f"{message}: no disparity but 0 fits, which is not in the range")
        warnings.append(f"{message}: as if all disparities were 0")
    return warnings


def reported(
    reconstruction: Reconstruction, truth: Truth | None = None, warnings: Sequence[str] = ()
) -> Reconstruction:
    """Add figures of every surface, warnings, and the error of the reference view."""
    array, labels = reconstruction.array, reconstruction.labels
    surfaces = [
        {"name": view.name, **_surface_figures(view, surface, labels)}
        for view, surface in zip(array, reconstruction.surfaces, strict=True)
    ]
    all_identical = len({view.image.tobytes() for view in array}) == 1
    figures: dict[str, Any] = {
        "surfaces": surfaces,
        "warnings": [*warnings, *_range_warnings(surfaces, labels, all_identical)],
    }
    if truth is not None:
        disparity = reconstruction.surfaces[array.reference].disparity
        figures["evaluation"] = evaluate(disparity, truth.disparity, truth.mask, THRESHOLDS_PX).to_dict()
    return replace(reconstruction, figures=reconstruction.figures | figures)


def summary(reconstruction: Reconstruction) -> str:
    """Format the figures that `reported` adds."""
    lines = [
        f"{view['name']}: disparities {_rounded(view['lowest_px'])} to {_rounded(view['highest_px'])} px, "
        f"{view['occluded_percent']:.1f} % seen in no other view"
        for view in reconstruction.figures["surfaces"]
    ]
    evaluation = reconstruction.figures.get("evaluation")
    if evaluation is not None:
        bad = ", ".join(f"{value:.2f} % > {key} px" for key, value in evaluation["bad_percent"].items())
        reference = reconstruction.array[reconstruction.array.reference].name
        lines.append(f"bad pixels of {reference}: {bad}")
    return "\n".join(lines)


def _rounded(disparity: float) -> str:
    return f"{round(disparity, 3) + 0.0:g}"


def write_previews(
    folder: Path, reconstruction: Reconstruction, truth: Truth | None = None, jobs: int = 1
) -> None:
    """Write pictures next to the data, and the page that shows them."""
    array, labels = reconstruction.array, reconstruction.labels
    legend = disparity_legend(array.shape[1], labels.lowest, labels.highest)

    def _previewed(index: int) -> Group:
        view, surface = array[index], reconstruction.surfaces[index]
        disparity = surface.disparity
        if view.valid is not None:
            disparity = np.where(view.valid, disparity, np.float32(np.nan))
        coloured = colour_disparity(disparity, labels.lowest, labels.highest)
        write_png(folder / f"preview-{view.name}.png", np.vstack([coloured, legend]))
        shown = [
            Shown("view", np.ascontiguousarray(view.image[:, :, ::-1])),
            Shown("disparity", coloured, "near is bright"),
            Shown("occluded", surface.occluded.astype(np.uint8) * 255, "white is seen in no other view"),
            Shown("confidence", np.rint(surface.confidence * 255).astype(np.uint8), "white is sure"),
        ]
        if truth is not None and index == array.reference:
            error = colour_error(*disparity_error(surface.disparity, truth.disparity, truth.mask))
            write_png(folder / f"error-{view.name}.png", error)
            text = "orange beyond 0.5 px, red beyond 1 px; grey does not count"
            shown.append(Shown("error", error, text))
        return Group(view.name, tuple(shown))

    with ThreadPoolExecutor(jobs) as pool:
        groups = list(pool.map(_previewed, range(len(array))))
    write_gallery(folder / PAGE, _gallery(reconstruction, groups))


def _surface_figures(view: ArrayView, surface: Surface, labels: DisparityLabels) -> dict[str, float]:
    """Return figures of a surface, without pixels that are empty after rectification."""
    seen = view.seen
    disparity = surface.disparity[seen]
    label = labels.label(disparity)
    return {
        "lowest_px": float(disparity.min()),
        "highest_px": float(disparity.max()),
        "occluded_percent": 100.0 * float(surface.occluded[seen].mean()),
        "mean_confidence": float(surface.confidence[seen].mean(dtype=np.float64)),
        "at_first_percent": 100.0 * float(np.mean(label == 0)),
        "at_last_percent": 100.0 * float(np.mean(label == labels.num_labels - 1)),
    }


def _range_warnings(
    surfaces: Sequence[dict[str, Any]], labels: DisparityLabels, all_identical: bool
) -> list[str]:
    if labels.num_labels < 3:
        return []
    warnings = []
    ends = (("first", "lowest", labels.lowest), ("last", "highest", labels.highest))
    for key, name, value in ends:
        if value == 0.0 and all_identical:
            continue
        share = float(np.mean([surface[f"at_{key}_percent"] for surface in surfaces]))
        if share > MAX_AT_AN_END_PERCENT:
            warnings.append(
                f"{share:.0f} % of the pixels have the {name} disparity, {value:g} px: "
                "the scene may extend beyond --disparities"
            )
    return warnings


def _gallery(reconstruction: Reconstruction, groups: Sequence[Group]) -> Gallery:
    array, labels, figures = reconstruction.array, reconstruction.labels, reconstruction.figures
    height, width = array.shape
    preface = (
        f"{len(array)} views of {width} × {height} pixels; disparities from {labels.lowest:g} to "
        f"{labels.highest:g} in steps of {labels.step:g} px per unit of m."
    )
    rows = [
        (
            view.name,
            f"{view.position.m:g}, {view.position.n:g}",
            f"{_rounded(surface['lowest_px'])} to {_rounded(surface['highest_px'])}",
            f"{surface['occluded_percent']:.1f} %",
            f"{surface['mean_confidence']:.2f}",
        )
        for view, surface in zip(array, figures["surfaces"], strict=True)
    ]
    head = ("view", "m, n", "disparities [px]", "in no other view", "confidence")
    tables = [Table("Views", "Surfaces of all views", head, tuple(rows))]
    if "evaluation" in figures:
        tables.insert(0, _evaluation_table(array[array.reference].name, figures["evaluation"]))
    return Gallery("Surfaces of all views", preface, groups, tables, figures["warnings"])


def _evaluation_table(name: str, evaluation: dict[str, Any]) -> Table:
    bad = evaluation["bad_percent"]
    error = evaluation["mean_absolute_error_px"]
    head = ("view", *(f"> {threshold} px" for threshold in bad), "mean absolute error", "pixels")
    shown = "–" if error is None else f"{error:.3f} px"
    row = (name, *(f"{percent:.2f} %" for percent in bad.values()), shown, str(evaluation["num_pixels"]))
    return Table("Against the truth", "Pixels farther off than a threshold", head, (row,))
