"""Distance of key frames if nothing is sent of the frames between them.

A decoder predicts a frame badly if tracks from both sides predict it badly. A key frame is worth its bits if
the error of the middle frame is large compared with the cost of the key frame. Both have the unit of the sum
that is minimised: squared error, and step^2 times bits.
"""

from collections.abc import Sequence
from math import isqrt, sqrt

import numpy as np
from numpy.typing import NDArray

from dvc.keyframes import KeyPicture
from dvc.video.frames import Plane
from encoder import _kernels
from encoder.encoder_report import TrackingWork, coding_time_s
from encoder.point_tracker import PointTracker

SPACING_PX = 16
"""Least distance between sampled blocks: one block in four is compared."""
MANY_BLOCKS = 900
"""Number of blocks that is enough: those of large pictures are farther apart."""
ALONE_COST, SHORT_COST = 0.7, 0.7
"""Largest mean squared error of the middle frame, over step^2 times the bits per pixel of a key frame, in a
group of two frames, before it becomes two key frames, and in a group of four that grows to eight. Chosen
among 0.6 to 1.1 and 0.5 to 0.9 on the nine clips of the results, 49 frames at QP 24 to 36;
`benchmarks.searches.settings --no-feedback encoder.spacing.ALONE_COST=1.1` compares."""
CLOSE_SHARE = 0.15
"""Bits of a key frame two frames after its reference over those of an IDR picture; they grow as the root
of the distance."""


def interpolation_error(
    frame: Plane, around: tuple[Plane, Plane], positions: NDArray[np.float64], work: TrackingWork
) -> float:
    """Return the squared error of the mean of two frames; `positions` (N, 3, 2) are now, before and after."""
    height, width = frame.shape
    spacing = max(SPACING_PX, isqrt(height * width // MANY_BLOCKS))
    error, count = _kernels.interpolation_error(
        frame, around[0], around[1], np.ascontiguousarray(positions), spacing
    )
    work.num_interpolated += count
    work.num_near += count * len(positions)
    return float(error)


class Spacing:
    """Decides where groups end if only key frames and tracks are sent."""

    def __init__(self, work: TrackingWork) -> None:
        self._work = work
        self._cost = 0.0  # step^2 times the bits of a key frame two frames after its reference

    def update(self, key: KeyPicture, qp: int, distance: int) -> None:
        """Learn the cost of key frames from one; `distance` is 0 if key frames have no references."""
        bits = 8.0 * len(key.data)
        if distance:
            bits *= sqrt(2.0 / distance) if key.predicted else CLOSE_SHARE
        step = 0.625 * 2.0 ** (qp / 6.0)  # of an H.264 quantiser
        self._cost = step**2 * bits

    def is_too_far(self, frames: Sequence[Plane], tracker: PointTracker) -> bool:
        """Return whether a group with these frames, after the first one, is too long for prediction."""
        last = len(frames) - 1
        if last not in (2, 4):
            return False
        positions = tracker.path(last + 1)[:, (last // 2, 0, last)]
        positions = positions[np.isfinite(positions).all(axis=(1, 2))]
        started = coding_time_s()
        error = interpolation_error(frames[last // 2], (frames[0], frames[last]), positions, self._work)
        self._work.cpu_s += coding_time_s() - started
        return error * frames[0].size > (ALONE_COST if last == 2 else SHORT_COST) * self._cost
