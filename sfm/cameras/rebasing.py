"""Change of basis: the model of two other views of a scene, and the reversal of its order of depths.

Correspondences and depths bounded from both sides leave two projective frames that differ by more than a
plane at infinity: one has all depths in the opposite order. If a camera turns about the scene, the linear
program of the self-calibration may prefer it, because near points move least. Image positions do not depend
on the order of depths; occlusions do.

See R. Hartley, "Chirality", Int. J. Computer Vision 26(1), 1998.
"""

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from dvc.arrays import Floats
from dvc.geometry.cameras import oriented, project
from dvc.geometry.triangulation import inverse_depths
from sfm.decompositions import svd
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels
from sfm.scene_model import Correspondences, Model

MIN_DETERMINANT = 1e-9
"""Least determinant of the left part of a finite camera, relative to its entries."""
FOCAL_LENGTHS = (1.2, 0.8, 1.8, 2.7)
"""Focal lengths to try, in units of the longer side of the image: usual, wide, then long."""
MIN_SHARE_AHEAD = 0.8
"""Least share of the points in front of both cameras of a plausible rigid motion."""
MARGIN = 1.0
"""Distance of the new plane at infinity from the nearest points, as a share of the inverse depths' range."""


QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class Rebased(NamedTuple):
    """A model in another basis."""

    model: Model  # two-view model; its correspondences are projections of the scene's points
    from_basis: Floats  # a camera of the old basis times this matrix is the same camera in the new basis

    def camera(self, camera: Floats) -> Floats | None:
        """Convert a camera to the basis of the model."""
        converted: Floats = camera @ self.from_basis
        return None if _oriented(converted) is None else converted


def rebase(model: Model, first_camera: Floats, second_camera: Floats) -> Rebased | None:
    """Return the model of two other views of a scene; None if they do not see it from finite positions."""
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
    """Return a camera with its sign fixed; None if its centre is at infinity."""
    determinant = float(np.linalg.det(camera[:, :3]))
    if abs(determinant) < MIN_DETERMINANT * max(float(np.abs(camera).max()), 1e-300) ** 3:
        return None
    return oriented(camera)


def is_reversed(model: Model) -> bool:
    """Return whether a rigid motion sees the depths of a model in the opposite order."""
    if not len(model.correspondences):
        return False
    camera, frame, seen = oriented(model.second_camera), model.pixel_frame, model.correspondences
    fundamental = fundamental_from_camera(camera)
    first, second = frame.to_normalized(seen.first), frame.to_normalized(seen.second)
    share, epipole = 0.0, np.zeros(3)
    for focal in FOCAL_LENGTHS:
        scale = np.array([focal, focal, 1.0])
        # The four rigid motions of an essential matrix, up to scale (Hartley and Zisserman, Sec. 9.6).
        u, _, vt = svd(scale[:, None] * fundamental * scale)
        u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
        for quarter, sign in product((QUARTER_TURN, QUARTER_TURN.T), (1.0, -1.0)):
            motion = np.column_stack([u @ quarter @ vt, sign * u[:, 2]])
            inverse, quotient = inverse_depths(first / focal, motion, second / focal)
            ahead = float(np.mean((inverse > 0) & (quotient > 0)))
            if ahead > share:
                share, epipole = ahead, scale * motion[:, 3]
    return share >= MIN_SHARE_AHEAD and float(epipole @ camera[:, 3]) < 0.0


def rigid_order(model: Model) -> Rebased | None:
    """Return the model with the order of depths reversed if a rigid motion requires that; else None."""
    if not is_reversed(model):
        return None
    lowest, highest = model.view_pair.inverse_depth_ranges[0]
    constant = highest + MARGIN * (highest - lowest)
    with np.errstate(divide="ignore"):
        inverse = constant - 1.0 / model.depths
    kept = np.isfinite(inverse) & (inverse > 0.0) & (model.depths > 0.0)
    basis = np.eye(4)
    basis[3, 2:] = constant, -1.0  # its own inverse
    camera = oriented(model.second_camera) @ basis
    if not kept.any() or not np.linalg.det(camera[:, :3]) > 0.0:
        return None
    seen, depths = model.correspondences[kept], 1.0 / inverse[kept]
    return Rebased(replace(model, second_camera=camera, correspondences=seen, depths=depths), basis)
