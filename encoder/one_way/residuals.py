"""What tracks alone leave to be told of a frame: its residual, references moved as points have moved.

The decoder knows the scene, and predicts better; how much better depends on how far apart the references are.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.video.frames import Plane
from dvc.wynerziv import transform
from encoder.one_way import _kernels

Floats = NDArray[np.float64]

MOTION_BLOCK_PX = 16
RESIDUAL_BLOCK_PX = 8


def motion_field(positions: Floats, reference: Floats, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Tell where blocks of a frame are in a reference, by the motion of the nearest points.

    Parameters
    ----------
    positions, reference : ndarray of shape (N, 2), float64
        Points (x, y) in the frame and in the reference, in pixels; nan where they are not known.
    shape : tuple of int
        Height and width of the frame.

    Returns
    -------
    ndarray of shape (rows, columns, 2), int64
        Displacements (x, y) of blocks of `MOTION_BLOCK_PX` in half pixels; zero without points.
    """
    field = np.zeros((*(-(-side // MOTION_BLOCK_PX) for side in shape), 2), np.int64)
    known = np.isfinite(positions).all(axis=1) & np.isfinite(reference).all(axis=1)
    if known.any():
        displacements = reference[known] - positions[known]
        _kernels.motion_field(positions[known], displacements, float(MOTION_BLOCK_PX), field)
    return field


def residual_magnitudes(
    luma: Plane, references: Sequence[Plane], fields: Sequence[NDArray[np.int64]]
) -> Floats:
    """Measure the residual of a frame against the mean of its references, each moved by a field.

    Parameters
    ----------
    luma : ndarray of shape (H, W), uint8
        The frame.
    references : sequence of ndarray of shape (H, W), uint8
        One or more frames.
    fields : sequence of ndarray of shape (rows, columns, 2), int64
        Displacements into each of them, from `motion_field`.

    Returns
    -------
    ndarray of shape (B, 16), float64
        Mean magnitude of the coefficients of each band in each block of `RESIDUAL_BLOCK_PX`, in units of the
        orthonormal transform; blocks that are not whole are left out.
    """
    height, width = luma.shape
    num_blocks = (height // RESIDUAL_BLOCK_PX) * (width // RESIDUAL_BLOCK_PX)
    magnitudes = np.empty((num_blocks, transform.NUM_BANDS))
    _kernels.residual_magnitudes(
        luma,
        np.stack(references),
        np.stack(fields),
        MOTION_BLOCK_PX,
        transform.SCALE,
        transform.ORDER,
        magnitudes,
    )
    return magnitudes
