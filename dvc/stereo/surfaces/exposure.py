"""Exposure of the cameras of an array: what the levels of one surface are in each view."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels
from dvc.stereo.surfaces.occupancy import Occupancy, shifts

Floats = NDArray[np.float64]

EXPOSURE_RATIO = 1.02
"""Ratio of levels up to which exposures are the same: costs do not tell."""
LEAST_POINTS = 500
"""Fewer tell nothing."""


def gains(array: CameraArray, labels: DisparityLabels, surface: Occupancy) -> Floats:
    """Return the factors (views, 3) that bring levels of all views to those of the reference.

    The median ratio, channel by channel, of what the surface of the reference shows in each view.
    """
    reference, found = array[array.reference], np.ones((len(array), 3))
    y, x = np.nonzero(surface.supported & reference.seen)
    label = surface.label[y, x]
    for index, view in enumerate(array):
        moved = shifts(labels, reference.position, view.position)[label]
        u, v = x + moved[:, 0], y + moved[:, 1]
        inside = (u >= 0) & (v >= 0) & (u < view.shape[1]) & (v < view.shape[0])
        inside[inside] = view.seen[v[inside], u[inside]]
        if index != array.reference and np.count_nonzero(inside) >= LEAST_POINTS:
            levels = reference.image[y[inside], x[inside]], view.image[v[inside], u[inside]]
            found[index] = np.median((levels[0] + 1.0) / (levels[1] + 1.0), axis=0)
    return found


def with_gains(array: CameraArray, factors: Floats) -> CameraArray:
    """Multiply the levels of views."""
    return CameraArray(tuple(_scaled(view, factor) for view, factor in zip(array, factors, strict=True)))


def _scaled(view: ArrayView, factor: Floats) -> ArrayView:
    if (factor == 1.0).all():
        return view
    levels = np.clip(np.floor(view.image * factor + 0.5), 0, 255).astype(np.uint8)
    return ArrayView(view.name, levels, view.position, view.valid)
