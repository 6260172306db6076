"""Fusion of the surfaces of all cameras: each takes what most of those that see a point say of it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.camera_array import CameraArray, DisparityLabels
from dvc.stereo.surfaces import _kernels
from dvc.stereo.surfaces.occupancy import fineness, shifts
from dvc.stereo.surfaces.settings import tolerance

Floats = NDArray[np.float64]

FUSION_ROUNDS = 2
"""The second one sees what the first one has put right."""


def fused(array: CameraArray, labels: DisparityLabels, maps: Sequence[Floats], index: int) -> Floats:
    """Bring the surface of a camera together with those of all others.

    Parameters
    ----------
    array : CameraArray
        The cameras.
    labels : DisparityLabels
        Disparities of the labels.
    maps : sequence of ndarray of shape (H, W), float64
        Labels of all cameras, or values between them.
    index : int
        The camera.

    Returns
    -------
    ndarray of shape (H, W), float64
        The median of the own label and of those that others have at the same point, within `tolerance`; of
        two in the middle the nearer one to the own. Where more cameras look through the point than have it,
        the own one included, the label behind it that most have, if these are more. Those of two cameras
        stay as they are.
    """
    here = array[index].position
    moved = np.stack([shifts(labels, here, view.position) for view in array])
    seen = np.stack([view.seen for view in array])
    found = np.empty(array.shape)
    _kernels.fuse(index, np.stack(maps), seen, moved, tolerance(fineness(array, labels)), found)
    return found
