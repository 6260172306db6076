"""Disparity maps against the truth, by the rule of the Middlebury evaluation (version 2)."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc import cli
from dvc.arrays import Mask
from dvc.errors import ConfigError
from dvc.picture_files import read_levels, read_pfm, read_picture, read_plane, write_png
from dvc.stereo.stereo_options import write_results
from dvc.web.drawing import colour_error

Floats = NDArray[np.floating]
MASKS = ("nonocc", "all", "disc")
"""Masks of the Middlebury evaluation: pixels that both views see, with known truth, near discontinuities."""


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
        bad = {f"{threshold:g}": percent for threshold, percent in self.bad_percent.items()}
        return {
            "num_pixels": self.num_pixels,
            "num_without_value": self.num_without_value,
            "bad_percent": bad,
            "mean_absolute_error_px": self.mean_absolute_error_px,
            "sparsification": {
                f"{threshold:g}": {"area_percent": area, "ideal_area_percent": ideal}
                for threshold, (area, ideal) in self.sparsification.items()
            },
        }


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
    finite = np.isfinite(errors)
    return Evaluation(
        int(errors.size),
        int(np.count_nonzero(~finite)),
        {threshold: 100.0 * float(np.mean(errors > threshold)) for threshold in thresholds},
        float(errors[finite].mean()) if finite.any() else None,
        {}
        if confidence is None
        else {threshold: sparsification(errors > threshold, confidence[counted]) for threshold in thresholds},
    )


def sparsification(bad: Mask, confidence: NDArray[np.number]) -> tuple[float, float]:
    """Return the area under the sparsification curve and that of the best order, in per cent.

    The area is the mean share of bad pixels among the N surest ones, over all N.
    """
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
    disparity: NDArray[np.float64] = np.where(is_defined, values / (scale or 1.0) + offset, np.nan)
    return disparity


def read_mask(path: str | Path) -> Mask:
    """Read a mask: pixels of value 255 count."""
    mask: Mask = read_picture(path)[:, :, 0] == 255
    return mask


def read_truth_of(arguments: argparse.Namespace) -> tuple[NDArray[np.float64], NDArray[np.bool_] | None]:
    """Read the truth and the mask that options name."""
    truth = read_truth(
        arguments.truth, arguments.truth_scale, arguments.truth_offset, arguments.truth_unknown
    )
    return truth, None if arguments.mask is None else read_mask(arguments.mask)


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
    write_results(arguments.json, result.to_dict(), _evaluation_text(result))
    return 0


def _evaluation_text(result: Evaluation) -> str:
    """Format the figures in one line."""
    bad = ", ".join(
        f"{percent:.2f} % > {threshold:g} px" for threshold, percent in result.bad_percent.items()
    )
    orders = [
        f"; area by confidence > {threshold:g} px {area:.2f} % (ideal {ideal:.2f})"
        for threshold, (area, ideal) in result.sparsification.items()
    ]
    error = "none" if result.mean_absolute_error_px is None else f"{result.mean_absolute_error_px:.3f} px"
    return f"bad pixels: {bad}; mean absolute error {error} ({result.num_pixels} pixels)" + "".join(orders)
