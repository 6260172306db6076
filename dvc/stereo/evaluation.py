"""Disparity maps against the truth, by the rule of Middlebury (version 2), and reports of reconstructions."""

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc import cli
from dvc.arrays import Mask
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels, Reconstruction
from dvc.picture_files import read_levels, read_pfm, read_picture, read_plane, write_png
from dvc.web.drawing import colour_disparity, colour_error, disparity_legend
from dvc.web.gallery import PAGE, Gallery, Group, Shown, Table, write_gallery

Floats = NDArray[np.floating]
Truth = tuple[NDArray[np.float64], Mask | None]
"""True disparities in pixels per unit of m, NaN if unknown, and the mask of pixels that count, if not all."""

MAX_AT_AN_END_PERCENT = 20.0
"""Largest share of pixels at the first or the last disparity without a warning."""
THRESHOLDS_PX = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Evaluation:
    """Errors of disparities against the truth."""

    num_pixels: int  # pixels with known truth inside the mask
    num_without_value: int  # pixels without a finite disparity: bad for every threshold
    # share of pixels with errors above a threshold, by threshold in pixels
    bad_percent: dict[float, float]
    mean_absolute_error_px: float | None  # over pixels with a finite disparity; None without any
    # area under the sparsification curve, and that of the best order, in per cent, by threshold in pixels
    sparsification: dict[float, tuple[float, float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-safe values; thresholds become text such as "0.5"."""
        areas = {
            f"{threshold:g}": {"area_percent": area, "ideal_area_percent": ideal}
            for threshold, (area, ideal) in self.sparsification.items()
        }
        bad = {f"{threshold:g}": percent for threshold, percent in self.bad_percent.items()}
        return asdict(self) | {"bad_percent": bad, "sparsification": areas}


def evaluate(
    disparity: Floats,
    truth: Floats,
    mask: Mask | None = None,
    thresholds: Sequence[float] = (1.0,),
    confidence: NDArray[np.number] | None = None,
) -> Evaluation:
    """Compare disparities with the truth, and the order of their confidence with that of their errors."""
    error, counted = disparity_error(disparity, truth, mask)
    errors = error[counted]
    if not errors.size:
        counting = "everywhere" if mask is None else "at all pixels of the mask"
        raise ConfigError(f"no pixel counts: the truth is unknown {counting}")
    finite, bad = np.isfinite(errors), {threshold: errors > threshold for threshold in thresholds}
    orders = {}
    if confidence is not None:
        orders = {threshold: sparsification(mask, confidence[counted]) for threshold, mask in bad.items()}
    return Evaluation(
        int(errors.size),
        int(np.count_nonzero(~finite)),
        {threshold: 100.0 * float(np.mean(mask)) for threshold, mask in bad.items()},
        float(errors[finite].mean()) if finite.any() else None,
        orders,
    )


def sparsification(bad: Mask, confidence: NDArray[np.number]) -> tuple[float, float]:
    """Return the mean share of bad pixels among the N surest ones over all N, and in the best order, in %."""
    _, rank = np.unique(-confidence.astype(np.float64), return_inverse=True)
    # equally sure pixels have no order: each counts as their mean
    count = np.bincount(rank)
    wrong = np.bincount(rank[bad], minlength=count.size)
    orders: tuple[Floats, Floats] = np.repeat(wrong / count, count), np.sort(bad).astype(np.float64)
    counts = np.arange(1, bad.size + 1)
    area, ideal = (100.0 * float(np.mean(np.cumsum(order) / counts)) for order in orders)
    return area, ideal


def disparity_error(
    disparity: Floats, truth: Floats, mask: Mask | None = None
) -> tuple[NDArray[np.float64], Mask]:
    """Return the error of every pixel, and the mask of pixels that count."""
    for name, plane in (("truth", truth), ("mask", mask)):
        if plane is not None and plane.shape != disparity.shape:
            sizes = [f"{shape[1]}x{shape[0]}" for shape in (plane.shape, disparity.shape)]
            raise ConfigError(f"the {name} is {sizes[0]}, but the disparity map is {sizes[1]}")
    counted = np.isfinite(truth) if mask is None else np.isfinite(truth) & mask
    finite = np.isfinite(disparity)
    error = np.where(finite, 0.0, np.inf)
    both = finite & counted
    error[both] = np.abs(disparity[both].astype(np.float64) - truth[both])
    error[~counted] = 0.0
    return error, counted


def read_truth(
    path: str | Path, scale: float | None = None, offset: float = 0.0, unknown: float | None = 0.0
) -> NDArray[np.float64]:
    """Read a true disparity map."""
    if scale is not None and not (np.isfinite(scale) and scale > 0.0):
        raise ConfigError(f"the scale of the truth must be positive, got {scale:g}")
    with open(path, "rb") as file:
        is_pfm = file.read(2) in (b"Pf", b"PF")
    if not is_pfm and scale is None:
        raise ConfigError(f"{path}: a picture needs --truth-scale: disparity = value / scale")
    values = read_pfm(path).astype(np.float64) if is_pfm else read_levels(path)
    is_defined = np.isfinite(values)
    if unknown is not None:
        is_defined &= values != unknown
    return np.where(is_defined, values / (scale or 1.0) + offset, np.nan)


def read_mask(path: str | Path) -> Mask:
    """Read a mask: pixels of value 255 count."""
    return np.asarray(read_picture(path)[:, :, 0] == 255)


def read_truth_of(arguments: argparse.Namespace) -> Truth:
    """Read the truth and the mask that options name."""
    truth = read_truth(
        arguments.truth, arguments.truth_scale, arguments.truth_offset, arguments.truth_unknown
    )
    return truth, None if arguments.mask is None else read_mask(arguments.mask)


def write_results(json: str | None, results: dict[str, Any], text: str) -> None:
    """Write results as `--json` asks, and a text, if any, unless JSON is on standard output."""
    if json is not None:
        cli.write_json(json, results)
    if json != "-" and text:
        sys.stdout.write(text + "\n")


def run(arguments: argparse.Namespace) -> int:
    """Run `dvc-stereo evaluate`."""
    outputs = [name for name in (arguments.json, arguments.error_map) if name not in (None, "-")]
    maps = [name for name in (arguments.mask, arguments.confidence) if name is not None]
    inputs = [arguments.path, arguments.truth, *maps]
    cli.check_outputs(inputs, outputs)
    disparity = read_pfm(arguments.path)
    truth, mask = read_truth_of(arguments)
    confidence = None
    if arguments.confidence is not None:
        confidence = read_plane(Path(arguments.confidence), 1, disparity.shape)
    result = evaluate(disparity, truth, mask, arguments.thresholds, confidence)
    if arguments.error_map is not None:
        write_png(Path(arguments.error_map), colour_error(*disparity_error(disparity, truth, mask)))
    bad = ", ".join(
        f"{percent:.2f} % > {threshold:g} px" for threshold, percent in result.bad_percent.items()
    )
    orders = [
        f"; area by confidence > {threshold:g} px {area:.2f} % (ideal {ideal:.2f})"
        for threshold, (area, ideal) in result.sparsification.items()
    ]
    error = "none" if result.mean_absolute_error_px is None else f"{result.mean_absolute_error_px:.3f} px"
    text = f"bad pixels: {bad}; mean absolute error {error} ({result.num_pixels} pixels)" + "".join(orders)
    write_results(arguments.json, result.to_dict(), text)
    return 0


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
    surfaces = []
    for view, surface in zip(array, reconstruction.surfaces, strict=True):
        seen = view.seen  # without pixels that are empty after rectification
        disparity = surface.disparity[seen]
        label = labels.label(disparity)
        surfaces.append(
            {
                "name": view.name,
                "lowest_px": float(disparity.min()),
                "highest_px": float(disparity.max()),
                "occluded_percent": 100.0 * float(surface.occluded[seen].mean()),
                "mean_confidence": float(surface.confidence[seen].mean(dtype=np.float64)),
                "at_first_percent": 100.0 * float(np.mean(label == 0)),
                "at_last_percent": 100.0 * float(np.mean(label == labels.num_labels - 1)),
            }
        )
    all_identical = len({view.image.tobytes() for view in array}) == 1
    warnings = list(warnings)
    for key, name, value in (("first", "lowest", labels.lowest), ("last", "highest", labels.highest)):
        share = float(np.mean([surface[f"at_{key}_percent"] for surface in surfaces]))
        is_expected = labels.num_labels < 3 or (value == 0.0 and all_identical)
        if share > MAX_AT_AN_END_PERCENT and not is_expected:
            warnings.append(
                f"{share:.0f} % of the pixels have the {name} disparity, {value:g} px: "
                "the scene may extend beyond --disparities"
            )
    figures: dict[str, Any] = {"surfaces": surfaces, "warnings": warnings}
    if truth is not None:
        disparity = reconstruction.surfaces[array.reference].disparity
        figures["evaluation"] = evaluate(disparity, *truth, THRESHOLDS_PX).to_dict()
    return replace(reconstruction, figures=reconstruction.figures | figures)


def summary(reconstruction: Reconstruction) -> str:
    """Format the figures that `reported` adds."""
    lines = [
        f"{view['name']}: disparities {_range(view)} px, "
        f"{view['occluded_percent']:.1f} % seen in no other view"
        for view in reconstruction.figures["surfaces"]
    ]
    evaluation = reconstruction.figures.get("evaluation")
    if evaluation is not None:
        bad = ", ".join(f"{value:.2f} % > {key} px" for key, value in evaluation["bad_percent"].items())
        reference = reconstruction.array[reconstruction.array.reference].name
        lines.append(f"bad pixels of {reference}: {bad}")
    return "\n".join(lines)


def _range(view: dict[str, Any]) -> str:
    return " to ".join(f"{round(view[key], 3) + 0.0:g}" for key in ("lowest_px", "highest_px"))


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
            error = colour_error(*disparity_error(surface.disparity, *truth))
            write_png(folder / f"error-{view.name}.png", error)
            text = "orange beyond 0.5 px, red beyond 1 px; grey does not count"
            shown.append(Shown("error", error, text))
        return Group(view.name, tuple(shown))

    with ThreadPoolExecutor(jobs) as pool:
        groups = list(pool.map(_previewed, range(len(array))))
    figures = reconstruction.figures
    height, width = array.shape
    preface = (
        f"{len(array)} views of {width} × {height} pixels; disparities from {labels.lowest:g} to "
        f"{labels.highest:g} in steps of {labels.step:g} px per unit of m."
    )
    rows = [
        (
            view.name,
            f"{view.position.m:g}, {view.position.n:g}",
            _range(surface),
            f"{surface['occluded_percent']:.1f} %",
            f"{surface['mean_confidence']:.2f}",
        )
        for view, surface in zip(array, figures["surfaces"], strict=True)
    ]
    head = ("view", "m, n", "disparities [px]", "in no other view", "confidence")
    tables = [Table("Views", "Surfaces of all views", head, tuple(rows))]
    if "evaluation" in figures:
        evaluation = figures["evaluation"]
        bad, error = evaluation["bad_percent"], evaluation["mean_absolute_error_px"]
        limits = ("view", *(f"> {threshold} px" for threshold in bad), "mean absolute error", "pixels")
        mean = "–" if error is None else f"{error:.3f} px"
        percents = [f"{percent:.2f} %" for percent in bad.values()]
        row = (array[array.reference].name, *percents, mean, str(evaluation["num_pixels"]))
        tables.insert(0, Table("Against the truth", "Pixels farther off than a threshold", limits, (row,)))
    gallery = Gallery("Surfaces of all views", preface, groups, tables, figures["warnings"])
    write_gallery(folder / PAGE, gallery)
