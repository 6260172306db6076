"""Protocol of a baseline, and the quality of decoded views: PSNR by (3.1)."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from dvc.images.colour import Picture
from dvc.metrics import PEAK, psnr_db


class Quality(NamedTuple):
    """PSNR of all views of a scene."""

    pooled_db: float  # PSNR of the mean squared error over all views, the reference included (3.1)
    mean_db: float  # mean of the PSNRs
    by_view_db: tuple[float, ...]


class BaselineResult(NamedTuple):
    """Coded views."""

    num_bytes: int  # size of all files
    quality: Quality  # quality of the views, decoded or rendered
    split: float  # share of the disparities, or of the second view, in the bytes
    setting: str  # qualities that were chosen


class Baseline(Protocol):
    """A way to code two views."""

    @property
    def name(self) -> str:
        """Name in tables."""

    def best_within(self, max_bytes: int) -> BaselineResult | None:
        """Return the best result of at most a number of bytes, or None if nothing fits."""


def quality_of(views: Sequence[Picture], truths: Sequence[Picture]) -> Quality:
    """Compare views with the pictures of their cameras."""
    by_view = [
        psnr_db(view.reshape(view.shape[0], -1), truth.reshape(truth.shape[0], -1))
        for view, truth in zip(views, truths, strict=True)
    ]
    squared = float(np.mean([PEAK**2 * 10.0 ** (-psnr / 10.0) for psnr in by_view]))
    pooled = math.inf if squared == 0.0 else 10.0 * math.log10(PEAK**2 / squared)
    return Quality(pooled, float(np.mean(by_view)), tuple(by_view))


def best(results: Sequence[BaselineResult]) -> BaselineResult | None:
    """Return the result of the highest pooled PSNR."""
    return max(results, key=lambda result: result.quality.pooled_db, default=None)
