"""How good decoded views are: PSNR by (3.1), and what a codec has made of all views in how many bytes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dvc.images.colour import Picture
from dvc.metrics import PEAK, psnr_db


class Quality(NamedTuple):
    """PSNR of all views of a scene."""

    pooled_db: float  # by (3.1): of the mean squared error over all views, the reference included
    mean_db: float  # mean of the PSNRs
    by_view_db: tuple[float, ...]  # PSNR of each view


class PeerResult(NamedTuple):
    """What a codec has made of all views."""

    num_bytes: int  # all of its files
    quality: Quality  # of the views that were decoded or rendered
    split: float  # share of the disparities, or of the second view, in the bytes
    setting: str  # what was chosen


def quality_of(found: Sequence[Picture], truths: Sequence[Picture]) -> Quality:
    """Compare views with what cameras saw."""
    by_view = [
        psnr_db(one.reshape(one.shape[0], -1), truth.reshape(truth.shape[0], -1))
        for one, truth in zip(found, truths, strict=True)
    ]
    squared = float(np.mean([PEAK**2 * 10.0 ** (-psnr / 10.0) for psnr in by_view]))
    pooled = math.inf if squared == 0.0 else 10.0 * math.log10(PEAK**2 / squared)
    return Quality(pooled, float(np.mean(by_view)), tuple(by_view))
