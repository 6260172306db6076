"""Sampling of pictures between their pixels."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels

Floats = NDArray[np.float64]


def sample(plane: NDArray[np.uint8], positions: Floats) -> Floats:
    """Interpolate a plane by cubic convolution of fourth order (six points), in single precision."""
    samples = np.empty(positions.shape[:2])
    padded = np.pad(plane, _kernels.PADDING, mode="edge").astype(np.float32)
    _kernels.sample_image(padded, positions, samples)
    return samples
