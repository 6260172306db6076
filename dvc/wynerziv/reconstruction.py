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
    lower, upper : ndarray, float64
        Borders of the decoded bin, `lower` <= `upper`.
    side_information : ndarray, float64
        Predicted coefficient y.
    scale : ndarray, float64
        Scale of the Laplacian, positive.

    Returns
    -------
    ndarray, float64
        Reconstruction, within the borders.

    References
    ----------
    [Kubasov2007] Eq. (6).
    """
    split = np.clip(side_information, lower, upper)
    left_mass, left_offset = _one_sided(split - lower, scale)
    right_mass, right_offset = _one_sided(upper - split, scale)
    # Outside the bin only one side has any width, and the common factor exp(-distance) cancels.
    total = left_mass + right_mass
    shift = np.where(total > 0.0, right_mass * right_offset - left_mass * left_offset, 0.0)
    mean = split + shift / np.where(total > 0.0, total, 1.0)
    return np.clip(mean, lower, upper)


def _one_sided(width: Array, scale: Array) -> tuple[Array, Array]:
    """Mass and mean offset of exp(-t / scale) on [0, width]; closed form, with its limit for narrow bins."""
    ratio = width / scale
    mass = -np.expm1(-ratio)
    safe = np.where(mass > 0.0, mass, 1.0)
    offset = scale - width * np.exp(-ratio) / safe
    return mass, np.where(ratio < 1e-3, 0.5 * width, offset)
