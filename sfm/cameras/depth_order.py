"""The order of depths: which of two surfaces is the nearer one, as a rigid motion of the camera sees it.

Correspondences and depths bounded from both sides leave two projective frames that differ by more than a
plane at infinity: in one of them all depths are in the opposite order. Where a camera turns about what it
looks at, the linear program of the self-calibration may prefer that one, because what is near moves least.
Where points are seen does not depend on it; what hides what does.

References
----------
[Hartley1998] R. Hartley, "Chirality", Int. J. Computer Vision 26(1), 1998.
[HartleyZisserman2003] R. Hartley, A. Zisserman, "Multiple view geometry in computer vision", 2nd ed., 2003:
Sec. 9.6, four rigid motions of an essential matrix.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import oriented
from dvc.geometry.triangulation import inverse_depths
from sfm.cameras.rebasing import Rebased
from sfm.decompositions import svd
from sfm.estimation.epipolar import fundamental_from_camera
from sfm.model import Model

Floats = NDArray[np.float64]

FOCAL_LENGTHS = (1.2, 0.8, 1.8, 2.7)
"""That are tried, in units of the longer side of the image: the usual one, wider angles, longer lenses."""
MIN_SHARE_AHEAD = 0.8
"""Share of the points that must lie before both cameras of the rigid motion for it to be believed."""
MARGIN = 1.0
"""Distance of the new plane at infinity from the nearest points, as a share of the inverse depths' range."""


def rigid_order(model: Model) -> Rebased | None:
    """Describe a scene whose depths a rigid motion sees in the opposite order so that they are in that
    order.
    """
    return _reversed(model) if is_reversed(model) else None


def is_reversed(model: Model) -> bool:
    """Tell whether what a model has nearer is farther away."""
    if not len(model.correspondences):
        return False
    camera, frame, seen = oriented(model.second_camera), model.pixel_frame, model.correspondences
    fundamental = fundamental_from_camera(camera)
    first, second = frame.to_normalized(seen.first), frame.to_normalized(seen.second)
    share, epipole = 0.0, np.zeros(3)
    for focal in FOCAL_LENGTHS:
        scale = np.array([focal, focal, 1.0])
        for motion in _rigid_motions(scale[:, None] * fundamental * scale):
            inverse, quotient = inverse_depths(first / focal, motion, second / focal)
            ahead = float(np.mean((inverse > 0) & (quotient > 0)))
            if ahead > share:
                share, epipole = ahead, scale * motion[:, 3]
    return share >= MIN_SHARE_AHEAD and float(epipole @ camera[:, 3]) < 0.0


def _rigid_motions(essential: Floats) -> list[Floats]:
    """Return the four rigid motions ``[R | t]`` with ``[t]x R`` nearest to a matrix, up to scale."""
    u, _, vt = svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return [
        np.column_stack([u @ quarter @ vt, sign * u[:, 2]])
        for quarter, sign in product((turn, turn.T), (1.0, -1.0))
    ]


def _reversed(model: Model) -> Rebased | None:
    """Subtract inverse depths from a constant: a plane before the nearest points becomes that at infinity."""
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
