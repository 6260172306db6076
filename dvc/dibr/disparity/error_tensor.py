"""Error tensor: how well each disparity label predicts the other views at each pixel of the reference.

Views are compensated backwards: each is sampled where it would see a pixel of the reference if that had the
label's disparity, or depth. Where this is depends on the label by a homography, which for rectified views is
a translation.

References
----------
[Maitre2008] Eqs. (3.6), (3.12), (3.31).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels

Floats = NDArray[np.float64]
Tensor = NDArray[np.float32]


def error_tensor(
    reference: NDArray[np.floating],
    views: Sequence[NDArray[np.floating]],
    warps: Sequence[Floats],
    inverse_depths: Floats,
) -> Tensor:
    """Return the squared error of each label at each pixel, per view."""
    if not views or len(views) != len(warps):
        raise ValueError(f"`views` must be at least one, with a warp each, got {len(views)}, {len(warps)}")
    planes = [_with_channels(view) for view in views]
    target = _with_channels(reference)
    if any(plane.shape[2] != target.shape[2] for plane in planes):
        raise ValueError("`views` must have the channels of the reference")
    tensor = np.zeros((*target.shape[:2], len(inverse_depths)), np.float32)
    count = np.zeros(tensor.shape, np.uint8 if len(views) < 256 else np.uint16)
    for plane, warp in zip(planes, warps, strict=True):
        homographies = np.tile(warp[:, :3], (len(inverse_depths), 1, 1))
        homographies[:, :, 2] += inverse_depths[:, None] * warp[:, 3]
        _kernels.add_squared_errors(target, plane, homographies, tensor, count)
    _kernels.normalise_errors(tensor, count, len(views))
    return tensor


def _with_channels(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(image.reshape(*image.shape[:2], -1), np.float32)
