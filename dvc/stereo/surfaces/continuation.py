"""Continuation of a camera's surfaces over what no other camera agrees on."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.continuation import SeenDepth, Slopes, continue_surfaces
from dvc.geometry.depth_maps import Visibility
from dvc.stereo.surfaces.occupancy import Occupancy

Floats = NDArray[np.float64]

SLOPE_RADIUS_PX = 34
"""Where the slope of a surface is measured: wide, since labels are whole numbers."""
SLOPE_LIMIT = 3.0
"""Pixels of parallax by which a surface may differ in this radius."""
SLOPE_SPACING_PX = 2
"""Between the pixels that it is measured with; these are enough."""
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
    fineness: float,
) -> Floats:
    """Continue the supported surfaces of a camera over the rest of its view."""
    warps = _warp(labels, *positions), _warp(labels, *positions[::-1])
    slopes = Slopes(SLOPE_RADIUS_PX, SLOPE_LIMIT * fineness, REACH_PX, SLOPE_SPACING_PX)
    red, green, blue = np.moveaxis(image.astype(np.float64), 2, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    filled = continue_surfaces(_seen(own), luma, _seen(other), warps, slopes, SLACK_PX)
    return np.clip(filled, 0.0, labels.num_labels - 1.0)


def _warp(labels: DisparityLabels, source: LatticePosition, target: LatticePosition) -> Floats:
    """Warp of points whose inverse depth is a label (2.5)."""
    dm, dn = source.m - target.m, source.n - target.n
    moved, low = labels.step, labels.lowest
    return np.array(
        [[1.0, 0.0, dm * low, dm * moved], [0.0, 1.0, dn * low, dn * moved], [0.0, 0.0, 1.0, 0.0]]
    )


def _seen(occupancy: Occupancy) -> SeenDepth:
    visibility = np.where(occupancy.supported, Visibility.CONSISTENT, Visibility.OCCLUDED)
    return SeenDepth(occupancy.label.astype(np.float64), visibility.astype(np.int8))
