"""Surfaces of all cameras of an array."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from dvc.multiview.camera_array import CameraArray, DisparityLabels
from dvc.multiview.inference import semi_global
from dvc.stereo.surfaces import Reconstruction, Surface


def reconstruct(
    array: CameraArray, labels: DisparityLabels, *, advance: Callable[[int], None] = lambda _: None
) -> Reconstruction:
    """Find the surfaces of all views.

    Parameters
    ----------
    array : CameraArray
        At least two views.
    labels : DisparityLabels
        Disparities to try.
    advance : callable, optional
        Told the number of steps that have just been finished.

    Returns
    -------
    Reconstruction
        A surface for each view.
    """
    surfaces = []
    for index in range(len(array)):
        surfaces.append(_surface(array, index, labels))
        advance(1)
    return Reconstruction(array, labels, tuple(surfaces))


def _surface(array: CameraArray, index: int, labels: DisparityLabels) -> Surface:
    view = array[index]
    cost = np.full((*array.shape, labels.num_labels), 60.0, np.float32)
    for other in array:
        if other is view:
            continue
        for label in range(labels.num_labels):
            disparity = labels.lowest + labels.step * label
            dx = round((other.position.m - view.position.m) * disparity)
            dy = round((other.position.n - view.position.n) * disparity)
            cost[:, :, label] = np.minimum(cost[:, :, label], _difference(view.image, other.image, dx, dy))
    cost = uniform_filter(cost, (3, 3, 1))
    chosen, confidence = semi_global(cost.astype(np.int16), view.image[:, :, 1], 8, 60)
    clear = np.clip(confidence / 100.0, 0.0, 1.0).astype(np.float32)
    return Surface(labels.disparity(chosen).astype(np.float32), np.zeros(array.shape, np.bool_), clear)


def _difference(image: NDArray[np.uint8], other: NDArray[np.uint8], dx: int, dy: int) -> NDArray[np.float32]:
    moved = np.roll(other.astype(np.float32), (dy, dx), (0, 1))
    difference: NDArray[np.float32] = np.abs(image.astype(np.float32) - moved).mean(axis=2)
    return difference
