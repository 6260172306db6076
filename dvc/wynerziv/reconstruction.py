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
    """Return E[x | lower <= x < upper, y] under a Laplacian about y."""
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
