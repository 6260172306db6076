"""Disparity maps against the truth, by the rule of the Middlebury evaluation (version 2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError
from dvc.pfm import read_pfm
from dvc.picture_files import read_levels, read_picture

Floats = NDArray[np.floating]
MASKS = ("nonocc", "all", "disc")
"""Masks of the Middlebury evaluation: pixels that both views see, with known truth, near discontinuities."""


@dataclass(frozen=True)
class Evaluation:
    """How far disparities are from the truth.

    Attributes
    ----------
    num_pixels : int
        Pixels that count: the truth is known, and the mask has them.
    num_without_value : int
        Those of them without a finite disparity: bad for every threshold.
    bad_percent : dict of float to float
        Pixels that are farther off than a threshold, in per cent, by threshold in pixels.
    mean_absolute_error_px : float or None
        Over the pixels with a finite disparity; None where there is none.
    """

    num_pixels: int
    num_without_value: int
    bad_percent: dict[float, float]
    mean_absolute_error_px: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-safe values; thresholds become text such as "0.5".

        Returns
        -------
        dict
            By the names of the attributes.
        """
        bad = {f"{threshold:g}": percent for threshold, percent in self.bad_percent.items()}
        return {
            "num_pixels": self.num_pixels,
            "num_without_value": self.num_without_value,
            "bad_percent": bad,
            "mean_absolute_error_px": self.mean_absolute_error_px,
        }


def evaluate(
    disparity: Floats,
    truth: Floats,
    mask: NDArray[np.bool_] | None = None,
    thresholds: Sequence[float] = (1.0,),
) -> Evaluation:
    """Compare disparities with the truth.

    Parameters
    ----------
    disparity : ndarray of shape (H, W), float
        In pixels; what is not finite counts as bad.
    truth : ndarray of shape (H, W), float
        In the same unit; not finite: unknown, which does not count.
    mask : ndarray of shape (H, W), bool, optional
        Pixels that count; all by default.
    thresholds : sequence of float, optional
        Pixels are bad whose error is larger, strictly.

    Returns
    -------
    Evaluation
        The figures.

    Raises
    ------
    ConfigError
        If sizes differ, or no pixel counts.
    """
    error, counted = disparity_error(disparity, truth, mask)
    errors = error[counted]
    if not errors.size:
        counting = "everywhere" if mask is None else "wherever the mask is 255"
        raise ConfigError(f"no pixel counts: the truth is unknown {counting}")
    known = np.isfinite(errors)
    return Evaluation(
        int(errors.size),
        int(np.count_nonzero(~known)),
        {threshold: 100.0 * float(np.mean(errors > threshold)) for threshold in thresholds},
        float(errors[known].mean()) if known.any() else None,
    )


def disparity_error(
    disparity: Floats, truth: Floats, mask: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the error of every pixel, and which pixels count.

    Parameters
    ----------
    disparity, truth, mask
        As in `evaluate`.

    Returns
    -------
    error : ndarray of shape (H, W), float64
        Magnitude in pixels, infinite without a disparity; 0 where nothing counts.
    counted : ndarray of shape (H, W), bool
        Where the truth is known and the mask has the pixel.

    Raises
    ------
    ConfigError
        If sizes differ.
    """
    for name, plane in (("truth", truth), ("mask", mask)):
        if plane is not None and plane.shape != disparity.shape:
            sizes = [f"{shape[1]}x{shape[0]}" for shape in (plane.shape, disparity.shape)]
            raise ConfigError(f"the {name} is {sizes[0]}, but the disparity map is {sizes[1]}")
    counted = np.isfinite(truth) if mask is None else np.isfinite(truth) & mask
    known = np.isfinite(disparity)
    error = np.where(known, 0.0, np.inf)
    both = known & counted
    error[both] = np.abs(disparity[both].astype(np.float64) - truth[both])
    error[~counted] = 0.0
    return error, counted


def read_truth(
    path: str | Path, scale: float | None = None, offset: float = 0.0, unknown: float | None = 0.0
) -> NDArray[np.float64]:
    """Read a true disparity map.

    Parameters
    ----------
    path : str or Path
        Picture of one channel with 8 or 16 bits, or with equal channels; or a grey PFM file.
    scale, offset : float, optional
        Disparity is value / scale + offset. The scale of a picture must be given; that of a PFM file is 1.
    unknown : float or None, optional
        Value in the file that stands for unknown; None: there is none. What is not finite is unknown too.

    Returns
    -------
    ndarray of shape (H, W), float64
        In pixels; NaN where it is unknown.

    Raises
    ------
    ConfigError
        If the scale is missing, or not a positive number.
    DvcError
        If the file cannot be read.
    """
    if scale is not None and not (np.isfinite(scale) and scale > 0.0):
        raise ConfigError(f"the scale of the truth must be positive, got {scale:g}")
    with open(path, "rb") as file:
        is_pfm = file.read(2) in (b"Pf", b"PF")
    if not is_pfm and scale is None:
        raise ConfigError(f"{path}: a picture needs --truth-scale: disparity = value / scale")
    values = read_pfm(path).astype(np.float64) if is_pfm else read_levels(path)
    is_known = np.isfinite(values)
    if unknown is not None:
        is_known &= values != unknown
    disparity: NDArray[np.float64] = np.where(is_known, values / (scale or 1.0) + offset, np.nan)
    return disparity


def read_mask(path: str | Path) -> NDArray[np.bool_]:
    """Read a mask: value 255 counts, and no other.

    Parameters
    ----------
    path : str or Path
        Picture; of one with several channels the first counts.

    Returns
    -------
    ndarray of shape (H, W), bool
        The pixels that count.
    """
    mask: NDArray[np.bool_] = read_picture(path)[:, :, 0] == 255
    return mask
