"""Reconstruction of a coefficient: its conditional mean, given its bin and the side information.

References
----------
[Kubasov2007] D. Kubasov, J. Nayak, C. Guillemot, "Optimal reconstruction in Wyner-Ziv video coding with
multiple side information", MMSP 2007, Eq. (6).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def conditional_mean(lower: Array, upper: Array, side_information: Array, scale: Array) -> Array:
    """Return E[x | lower <= x < upper, y] under a Laplacian about y.

    Side information inside the bin is pulled towards the bin's middle, side information outside ends up near
    the closer border; both follow from splitting the bin at y and taking each side's mean, weighted by its
    probability.

    Parameters
    ----------
    lower, upper : ndarray of any shape, float64
        Borders of the decoded bin, `lower` <= `upper`.
    side_information : ndarray of the same shape, float64
        Predicted coefficient y.
    scale : ndarray of the same shape, float64
        Scale of the Laplacian, positive.

    Returns
    -------
    ndarray of the same shape, float64
        Reconstruction, within the borders.

    References
    ----------
    [Kubasov2007] Eq. (6).
    """
    from dvc.wynerziv import _kernels

    mean = np.empty_like(lower)
    _kernels.conditional_mean(
        lower.reshape(-1),
        upper.reshape(-1),
        side_information.reshape(-1),
        scale.reshape(-1),
        mean.reshape(-1),
    )
    return mean
