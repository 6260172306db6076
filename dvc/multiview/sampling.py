"""Sampling of pictures between their pixels."""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview import _kernels

Floats = NDArray[np.float64]


def sample(plane: NDArray[np.uint8], positions: Floats) -> Floats:
    """Interpolate a plane by cubic convolution of fourth order (six points); the border repeats.

    Parameters
    ----------
    plane : ndarray of shape (H, W), uint8
        Samples.
    positions : ndarray of shape (rows, columns, 2 or more), float64
        x and y, then anything.

    Returns
    -------
    ndarray of shape (rows, columns), float64
        Interpolated samples.

    References
    ----------
    [Keys1981] R. Keys, "Cubic convolution interpolation for digital image processing", IEEE Trans. Acoust.,
    Speech, Signal Process. 29(6), 1981.
    """
    samples = np.empty(positions.shape[:2])
    _kernels.sample_image(plane, positions, samples)
    return np.clip(samples, 0.0, 255.0)
