"""Pictures and PSNRs of chapter 5, from results of points alone."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.rd.measure import read_picture
from dvc.rd.rd_results import PictureFiles, PointResult
from dvc.web.drawing import Picture, in_rows, with_title

NOISE_GAIN = 4
"""Differences are drawn so many times as large."""


def predicted(point: PointResult) -> dict[int, float]:
    """Return the PSNR of each predicted frame, by its number."""
    return {
        frame.index or 0: frame.si_psnr_y_db for frame in point.per_frame if frame.si_psnr_y_db is not None
    }


def keys(point: PointResult) -> dict[int, float]:
    """Return the PSNR of each key frame, by its number."""
    return {frame.index or 0: frame.psnr_y_db or 0.0 for frame in point.per_frame if frame.type == "key"}


def tracks_bpp(point: PointResult) -> float:
    """Return what tracks take, in bits per pixel of all frames."""
    pixels = point.sequence.width * point.sequence.height * point.totals.frames
    return point.totals.bits.get("tracks", 0) / pixels


def seen_db(point: PointResult) -> tuple[float | None, float | None]:
    """Return the PSNRs of the key frame and of the predicted frame that a point has pictures of."""
    files = point.pictures or PictureFiles()
    indices = [-1 if index is None else index for index in (files.key_index, files.index)]
    return keys(point).get(indices[0]), predicted(point).get(indices[1])


def noise(methods: Mapping[str, PointResult], folder: Path) -> Picture | None:
    """Draw the difference between one frame and its prediction by each method that has pictures."""
    panels = []
    for name, point in methods.items():
        planes = _planes(point, folder, ("original", "predicted"))
        if planes is not None:
            difference = planes[0] - planes[1]
            error = float(np.sqrt(np.mean(np.square(difference, dtype=np.float64))))
            levels = np.clip(128 + NOISE_GAIN * difference, 0, 255).astype(np.uint8)
            panels.append(with_title(levels, f"{name}: rms {error:.1f}"))
    return in_rows(panels, 2) if panels else None


def quality(point: PointResult, folder: Path) -> Picture | None:
    """Draw a decoded key frame and a frame that is predicted from it."""
    planes = _planes(point, folder, ("key", "predicted"))
    if planes is None:
        return None
    panels = []
    for kind, plane, psnr_db in zip(("key frame", "predicted"), planes, seen_db(point), strict=True):
        told = "" if psnr_db is None else f", {psnr_db:.1f} dB"
        panels.append(with_title(plane.astype(np.uint8), kind + told))
    return in_rows(panels, 2)


def _planes(point: PointResult, folder: Path, names: Sequence[str]) -> list[NDArray[np.int16]] | None:
    """Return pictures of a point, if all are there and of one size."""
    planes = []
    for name in names:
        path = getattr(point.pictures, name, None)
        plane = read_picture(folder / path) if path is not None else None
        if plane is None:
            return None
        planes.append(np.asarray(plane, dtype=np.int16))
    return planes if len({plane.shape for plane in planes}) == 1 else None
