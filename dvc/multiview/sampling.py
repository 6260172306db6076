"""Sampling of pictures between their pixels."""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview import _kernels

Floats = NDArray[np.float64]


def sample(plane: NDArray[np.uint8], positions: Floats) -> Floats:
    """Interpolate a plane by cubic convolution of fourth order (six points); the border repeats."""
    samples = np.empty(positions.shape[:2])
    _kernels.sample_image(plane, positions, samples)
    return np.clip(samples, 0.0, 255.0)
