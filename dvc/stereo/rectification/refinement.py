"""The calibration of a pair of cameras made consistent with the points that their pictures share."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dvc.geometry.calibrated_cameras import Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.rectification.rectify import rectify

Floats = NDArray[np.float64]

MAX_ERROR_PX = 1.5
"""Of matches, from their epipolar lines."""
MIN_MATCHES = 30
GOOD_ROWS_PX = 0.5
"""A calibration with rows that agree so well stays as it is."""
LEAST_GAIN = 0.1
"""Of the rms, below which it stays as well."""
_SEED = 0
_NOISE_PX = 0.3
_TURN_SIGMA = np.radians(0.3)
_FOCAL_SIGMA = 0.005
_MAX_SIGMAS = 6.0


def refined_pair(cameras: Sequence[Camera], first: Floats, second: Floats) -> tuple[Camera, ...]:
    """Tilt and roll two cameras, and balance their focal lengths, until the rows of matches agree."""
    inliers = _consistent(first, second)
    if np.count_nonzero(inliers) < MIN_MATCHES:
        return tuple(cameras)
    first, second = first[inliers], second[inliers]
    bare = rectify(cameras, (LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)))

    def _rows(correction: Floats) -> Floats:
        changed = replace(bare, cameras=_corrected(cameras, correction))
        return np.asarray((changed.rectified_points(0, first) - changed.rectified_points(1, second))[:, 1])

    sigmas = np.array([_TURN_SIGMA] * 4 + [_FOCAL_SIGMA])
    solved = least_squares(
        lambda x: np.concatenate([_rows(x * sigmas), _NOISE_PX * x]), np.zeros(5), max_nfev=100
    )
    before, after = (float(np.sqrt((_rows(x * sigmas) ** 2).mean())) for x in (np.zeros(5), solved.x))
    gains = before > GOOD_ROWS_PX and after < (1.0 - LEAST_GAIN) * before
    if not gains or np.abs(solved.x).max() > _MAX_SIGMAS:
        return tuple(cameras)
    return _corrected(cameras, solved.x * sigmas)


def _consistent(first: Floats, second: Floats) -> NDArray[np.bool_]:
    """Tell which matches one epipolar geometry explains."""
    import pycolmap

    options = pycolmap.RANSACOptions(max_error=MAX_ERROR_PX, random_seed=_SEED, num_threads=1)
    answer = pycolmap.estimate_fundamental_matrix(first, second, options) if len(first) >= 8 else None
    if answer is None:
        return np.zeros(len(first), dtype=np.bool_)
    return np.asarray(answer["inlier_mask"], dtype=np.bool_)


def _corrected(cameras: Sequence[Camera], correction: Floats) -> tuple[Camera, ...]:
    """Apply tilt and roll of both cameras, radians, and half the log of the ratio of their focal lengths."""
    made = []
    for camera, (tilt, roll), sign in zip(cameras, correction[:4].reshape(2, 2), (1.0, -1.0), strict=True):
        R = Rotation.from_rotvec([tilt, 0.0, roll]).as_matrix() @ camera.R
        scale = float(np.exp(sign * correction[4]))
        K = camera.K * np.array([[scale, scale, 1.0], [1.0, scale, 1.0], [1.0, 1.0, 1.0]])
        made.append(replace(camera, K=K, R=R, t=-R @ camera.centre))
    return tuple(made)
