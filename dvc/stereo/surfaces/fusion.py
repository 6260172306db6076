"""Fusion of the surfaces of all cameras: each takes what most of those that see a point say of it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.stereo.surfaces import _kernels
from dvc.stereo.surfaces.occupancy import fineness, shifts
from dvc.stereo.surfaces.settings import tolerance

Floats = NDArray[np.float64]

FUSION_ROUNDS = 2
"""The second one sees what the first one has put right."""


def fused(array: CameraArray, labels: DisparityLabels, maps: Sequence[Floats], index: int) -> Floats:
    """Bring the surface of a camera together with those of all others."""
    here = array[index].position
    moved = np.stack([shifts(labels, here, view.position) for view in array])
    seen = np.stack([view.seen for view in array])
    found = np.empty(array.shape)
    _kernels.fuse(index, np.stack(maps), seen, moved, tolerance(fineness(array, labels)), found)
    return found
