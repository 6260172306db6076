"""Change of basis: the model of two other views of the same scene, whose cameras are known."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import oriented, project
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels
from sfm.model import Correspondences, Model

Floats = NDArray[np.float64]

MIN_DETERMINANT = 1e-9
"""Of the left part of a camera, relative to its entries: below it the centre is at infinity."""


class Rebased(NamedTuple):
    """A model in another basis."""

    model: Model  # of the two views; its correspondences are where they see the points of the scene
    from_basis: Floats  # a camera of the old basis times this matrix is the same camera in the new one

    def camera(self, camera: Floats) -> Floats | None:
        """Convert a camera to the basis of the model."""
        converted: Floats = camera @ self.from_basis
        return None if _oriented(converted) is None else converted


def rebase(model: Model, first_camera: Floats, second_camera: Floats) -> Rebased | None:
    """Describe the scene of a model by two other views of it."""
    first, second = _oriented(first_camera), _oriented(second_camera)
    if first is None or second is None:
        return None
    to_basis = np.vstack([first, [0.0, 0.0, 0.0, 1.0]])
    from_basis = np.linalg.inv(to_basis)
    points = model.points @ to_basis.T
    camera = second @ from_basis
    if _oriented(camera) is None:
        return None
    x0, depth0 = project(np.eye(3, 4), points)
    x1, depth1 = project(camera, points)
    ahead = (depth0 > 0) & (depth1 > 0) & np.isfinite(x0).all(axis=1) & np.isfinite(x1).all(axis=1)
    if not ahead.any():
        return None
    frame = model.pixel_frame
    seen = Correspondences(
        frame.to_pixels(x0[ahead]), frame.to_pixels(x1[ahead]), model.correspondences.error[ahead]
    )
    fundamental = fundamental_to_pixels(fundamental_from_camera(camera), frame)
    depths = depth0[ahead] / points[ahead, 3]
    return Rebased(Model(frame, fundamental, camera, seen, depths), from_basis)


def _oriented(camera: Floats) -> Floats | None:
    """Give a camera its sign; None where its centre is at infinity."""
    determinant = float(np.linalg.det(camera[:, :3]))
    if abs(determinant) < MIN_DETERMINANT * max(float(np.abs(camera).max()), 1e-300) ** 3:
        return None
    return oriented(camera)
