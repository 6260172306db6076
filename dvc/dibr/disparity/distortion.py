"""Squared errors of maps: as the error tensor knows them, or as rendering finds them.

Backward compensation knows nothing of the holes that a map opens when other views are rendered forward
from it. Where these errors are known, the codecs choose by them.
"""

from collections.abc import Callable

import numpy as np

from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import Labels

Distortion = Callable[[Labels], float]
"""From a map of labels (H, W), int32, to its squared error: summed over the pixels, mean of all views."""


def backward_error(tensor: Tensor, labels: Labels) -> float:
    """Return the squared error of a map, as the tensor knows it.

    Parameters
    ----------
    tensor : ndarray of shape (H, W, labels), float32
        Error tensor.
    labels : ndarray of shape (H, W), int32
        Map of labels.

    Returns
    -------
    float
        Sum over the pixels.
    """
    return float(np.take_along_axis(tensor, labels[:, :, None], 2).sum(dtype=np.float64))
