"""Continuation of surfaces over what no two cameras agree on: of planes, across as few edges as possible."""

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.multiview import _kernels
from dvc.multiview.camera_array import DisparityLabels, LatticePosition
from dvc.multiview.depth_maps import CONTINUED_QUANTILE, EDGE_LEVELS, Visibility
from dvc.stereo.occupancy import Occupancy

Floats = NDArray[np.float64]

SLOPE_RADIUS_PX = 35
"""Where the slope of a surface is measured: wide, since labels are whole numbers."""
SLOPE_LIMIT = 3.0
"""Labels by which a surface may differ in this radius."""
REACH_PX = 80.0
"""How far slopes are continued."""
SLACK_PX = 1.5
"""Distance between surfaces that may be one, when it is asked whether a camera looks through a point."""


def continued(
    own: Occupancy,
    other: Occupancy,
    labels: DisparityLabels,
    positions: tuple[LatticePosition, LatticePosition],
    image: NDArray[np.uint8],
) -> Floats:
    """Continue the supported surfaces of a camera over the rest of its view.

    Parameters
    ----------
    own, other : Occupancy
        Of the camera, and of a neighbour: what that looks through is not continued to there.
    labels : DisparityLabels
        Disparities of the labels.
    positions : tuple of two LatticePosition
        Of both cameras.
    image : ndarray of shape (H, W, 3), uint8
        What the camera sees; surfaces end at its edges rather than elsewhere.

    Returns
    -------
    ndarray of shape (H, W), float64
        Labels; whole numbers where they are supported.
    """
    label = own.label.astype(np.float64)
    beside = cv2.dilate((~own.supported).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    slopes, filled = np.empty((*label.shape, 2)), np.empty_like(label)
    _kernels.local_slopes(label, own.supported, own.supported & beside, SLOPE_RADIUS_PX, SLOPE_LIMIT, slopes)
    there, back = (_warp(labels, *pair) for pair in (positions, positions[::-1]))
    _kernels.fill_depth(
        label,
        _visibility(own),
        image.astype(np.float64) @ np.array([0.299, 0.587, 0.114]),
        slopes,
        EDGE_LEVELS,
        REACH_PX,
        CONTINUED_QUANTILE,
        other.label.astype(np.float64),
        _visibility(other),
        there,
        back,
        SLACK_PX,
        filled,
    )
    return np.clip(filled, 0.0, labels.num_labels - 1.0)


def _warp(labels: DisparityLabels, source: LatticePosition, target: LatticePosition) -> Floats:
    """Warp of points whose inverse depth is a label (2.5)."""
    dm, dn = source.m - target.m, source.n - target.n
    moved, low = labels.step, labels.lowest
    return np.array(
        [[1.0, 0.0, dm * low, dm * moved], [0.0, 1.0, dn * low, dn * moved], [0.0, 0.0, 1.0, 0.0]]
    )


def _visibility(occupancy: Occupancy) -> NDArray[np.int8]:
    visibility: NDArray[np.int8] = np.where(
        occupancy.supported, Visibility.CONSISTENT, Visibility.OCCLUDED
    ).astype(np.int8)
    return visibility
