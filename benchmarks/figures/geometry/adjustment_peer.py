"""The bundle adjustment of a key pair as a general least-squares problem, for comparison."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_array

from dvc.multiview.cameras import PixelFrame, homogeneous, project
from sfm.cameras.projective_basis import camera_basis
from sfm.model import Correspondences

Floats = NDArray[np.float64]


def peer_adjustment(
    matches: Correspondences,
    camera: Floats,
    depths: Floats,
    frame: PixelFrame,
    fixed: NDArray[np.int64],
) -> float:
    """Minimise (5.6) over depths and second camera with scipy, in the same projective basis."""
    first, second = homogeneous(frame.to_normalized(matches.first)), frame.to_normalized(matches.second)
    points = np.column_stack([first[fixed], 1.0 / depths[fixed]])
    basis = camera_basis(points, project(camera, points)[0])
    free = np.setdiff1d(np.arange(len(first)), fixed)

    def residuals(parameters: Floats) -> Floats:
        matrix = (basis @ parameters[:8]).reshape(3, 4)
        inverse = 1.0 / depths
        inverse[free] = parameters[8:]
        image = first @ matrix[:, :3].T + inverse[:, None] * matrix[:, 3]
        return (image[:, :2] / image[:, 2:] - second).ravel() * frame.scale_px

    start = np.concatenate([basis.T @ camera.ravel(), 1.0 / depths[free]])
    found = least_squares(
        residuals,
        start,
        jac_sparsity=_structure(len(first), free),
        x_scale="jac",
        ftol=1e-14,
        xtol=1e-14,
        gtol=1e-14,
    )
    return float(np.sqrt(2.0 * found.cost / len(first)))


def _structure(count: int, free: NDArray[np.int64]) -> coo_array:
    """Tell which residuals depend on which parameters: all on the camera, each on its own depth."""
    rows = np.arange(2 * count)
    depth_rows = np.column_stack([2 * free, 2 * free + 1]).ravel()
    columns = np.concatenate([np.tile(np.arange(8), 2 * count), 8 + np.repeat(np.arange(len(free)), 2)])
    all_rows = np.concatenate([np.repeat(rows, 8), depth_rows])
    return coo_array((np.ones(len(columns)), (all_rows, columns)), shape=(2 * count, 8 + len(free)))
