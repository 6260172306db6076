"""Continuation of reliable surfaces over the rest of a view: of planes, across as few edges as possible."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels

Floats = NDArray[np.float64]

EDGE_LEVELS = 15.0
"""A step in luma that halves the weight of what lies behind it: well above the noise of a decoded frame."""
CONTINUED_QUANTILE = 0.5
"""Which of the continued inverse depths is taken, 0 being the farthest: wrong ones come from either side."""


class Slopes(NamedTuple):
    """How the slopes of surfaces are measured, and how far they are continued."""

    radius_px: int  # where the slope of a surface is measured
    limit: float  # inverse depth by which a surface may differ in this radius
    # how far slopes are continued; farther away their error would be larger than that of constant depth
    reach_px: float
    spacing_px: int = 1  # between points that slopes are measured with; a divisor of the radius


class SeenDepth(NamedTuple):
    """Inverse depth of a view, and what of it is reliable."""

    inverse_depth: Floats  # of every pixel
    visibility: NDArray[np.int8]  # a `Visibility` of every pixel: what is consistent is reliable


def continue_surfaces(
    own: SeenDepth,
    luma: Floats,
    other: SeenDepth,
    warps: tuple[Floats, Floats],
    slopes: Slopes,
    slack_px: float,
) -> Floats:
    """Continue the planes of what is reliable in eight directions."""
    reliable = own.visibility == _kernels.CONSISTENT
    measured, filled = np.empty((*reliable.shape, 2)), np.empty(reliable.shape)
    # only the rim of what is consistent is continued
    rim = reliable & (cv2.dilate((~reliable).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    window = slopes.radius_px, slopes.spacing_px, slopes.limit
    _kernels.local_slopes(own.inverse_depth, reliable, rim, *window, measured)
    how = _kernels.Continuation(EDGE_LEVELS, slopes.reach_px, CONTINUED_QUANTILE)
    _kernels.fill_depth(*own, luma, measured, how, _kernels.OtherView(*warps, *other, slack_px), filled)
    return filled
