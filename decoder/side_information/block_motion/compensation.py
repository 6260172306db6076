"""Quarter-sample planes of a reference frame, and overlapped block compensation from them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels
from dvc.video import Frame

MARGIN = 40
"""Samples by which planes are padded on each side, by replication."""

Offsets = NDArray[np.int64]
Luma = NDArray[np.uint8]


def phase_planes(plane: Luma, margin: int = MARGIN) -> NDArray[np.uint8]:
    """Interpolate a plane at quarter samples as H.264 does: six taps for half samples, then means of two."""
    padded = np.pad(plane, ((margin + 2, margin + 4), (margin + 2, margin + 4)), mode="edge")
    planes = np.empty((4, 4, plane.shape[0] + 2 * margin, plane.shape[1] + 2 * margin), np.uint8)
    _kernels.quarter_samples(padded, planes)
    return planes


def low_pass(plane: Luma) -> Luma:
    """Average over 3x3 samples, as motion search does before it compares noisy or quantised frames."""
    padded = np.pad(plane.astype(np.int32), 1, mode="edge")
    columns = padded[:-2] + padded[1:-1] + padded[2:]
    total = columns[:, :-2] + columns[:, 1:-1] + columns[:, 2:]
    smooth: Luma = ((total + 4) // 9).astype(np.uint8)
    return smooth


def halve(plane: Luma) -> Luma:
    """Average 2x2 samples into one; odd sides are padded by replication."""
    padded = np.pad(plane.astype(np.int32), ((0, plane.shape[0] & 1), (0, plane.shape[1] & 1)), mode="edge")
    total = padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]
    return ((total + 2) >> 2).astype(np.uint8)


def compensate(
    references: list[NDArray[np.uint8]],
    offsets: list[Offsets],
    weights: list[NDArray[np.float64]],
    block: int,
    shape: tuple[int, int],
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Predict a plane from displaced overlapping blocks of several references."""
    rows, columns = offsets[0].shape[:2]
    ramp = (np.minimum(np.arange(2 * block) + 0.5, 2 * block - 0.5 - np.arange(2 * block))) / block
    taper = np.outer(ramp, ramp)
    inside = (slice(block // 2, block // 2 + shape[0]), slice(block // 2, block // 2 + shape[1]))
    totals, masses = [], []
    for planes, offset, weight in zip(references, offsets, weights, strict=True):
        total = np.zeros(((rows + 1) * block, (columns + 1) * block))
        mass = np.zeros_like(total)
        _kernels.accumulate_blocks(planes, MARGIN, block, taper, offset, weight, total, mass)
        totals.append(total[inside])
        masses.append(mass[inside])
    compensated = [total / mass for total, mass in zip(totals, masses, strict=True)]
    return sum(totals[1:], totals[0]) / sum(masses[1:], masses[0]), compensated


def compensate_chroma(
    references: Sequence[Frame],
    offsets: Sequence[Offsets],
    weights: Sequence[NDArray[np.float64]],
    block: int,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
    """Predict the chroma planes with the offsets of the luma blocks."""
    chroma = [frame.chroma for frame in references]
    halved = [offset >> 1 for offset in offsets]
    predicted = []
    for component in (0, 1):
        planes = [pair[component] for pair in chroma if pair is not None]
        if len(planes) < len(chroma):
            return None
        samples, _ = compensate(
            [phase_planes(plane) for plane in planes], halved, list(weights), block // 2, planes[0].shape
        )
        predicted.append(np.floor(samples + 0.5).astype(np.uint8))
    return predicted[0], predicted[1]


def resize_field(field: Offsets, rows: int, columns: int, factor: int) -> Offsets:
    """Repeat each vector of a field on a finer grid."""
    row = np.minimum(np.arange(rows) // factor, field.shape[0] - 1)
    column = np.minimum(np.arange(columns) // factor, field.shape[1] - 1)
    return np.ascontiguousarray(field[row][:, column])
