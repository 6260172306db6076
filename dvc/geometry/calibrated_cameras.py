"""Calibrated cameras: projection, lens distortion, and the decomposition of projection matrices.

Convention: the world is right-handed, in any unit. Camera axes are x right, y down, z forward; K is in
pixels, the centre of the first pixel at (0, 0). Undistorted pixels are those of the same camera without
lens distortion.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import rq

from dvc.arrays import Floats
from dvc.errors import ConfigError

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0)
LARGEST = 1e12
"""Largest magnitude of elements of matrices and points; larger ones are no measurement."""
_MIN_FOCAL_PX, _MAX_FOCAL_PX = 1e-2, 1e8
_UNDISTORTION_STEPS = 200
_UNDISTORTION_ERROR = 1e-10


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated picture."""

    name: str  # name of its file, without the folder
    K: Floats  # upper triangular, positive diagonal, last element 1
    R: Floats  # rotation from the world to the camera
    t: Floats  # a point X of the world lies at ``R X + t`` in the camera
    size: tuple[int, int]  # width and height in pixels
    # k1, k2, p1, p2 of Brown's model, as in OpenCV: with only k1, a point at x in normalised coordinates is
    # seen at ``x (1 + k1 |x|^2)``
    distortion: tuple[float, float, float, float] = NO_DISTORTION

    @property
    def centre(self) -> Floats:
        """Centre of the camera (2.2)."""
        return -self.R.T @ self.t

    @property
    def projection(self) -> Floats:
        """``P = K R [I | -c]`` (2.2), to undistorted pixels."""
        return self.K @ np.column_stack([self.R, self.t])

    @property
    def focal_length_px(self) -> float:
        """Mean of the focal lengths along rows and columns."""
        return 0.5 * float(self.K[0, 0] + self.K[1, 1])

    def distorted(self, points: Floats) -> Floats:
        """Apply the lens distortion; inverse of `undistorted`."""
        if self.distortion == NO_DISTORTION:
            return points
        return self._to_pixels(self._distort(self._to_normalized(points)))

    def undistorted(self, points: Floats) -> Floats:
        """Remove the lens distortion."""
        if self.distortion == NO_DISTORTION:
            return points
        seen = self._to_normalized(points)
        straight = seen
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_UNDISTORTION_STEPS):
                change = seen - self._distort(straight)
                straight = straight + change
                if np.abs(change).max(initial=0.0) < _UNDISTORTION_ERROR:
                    return self._to_pixels(straight)
        raise ConfigError(f"camera of {self.name}: its lens distortion is too strong to be undone")

    def _distort(self, x: Floats) -> Floats:
        k1, k2, p1, p2 = self.distortion
        a, b = x[:, 0], x[:, 1]
        r2 = a * a + b * b
        radial = 1.0 + (k1 + k2 * r2) * r2
        tangential = [2 * p1 * a * b + p2 * (r2 + 2 * a * a), p1 * (r2 + 2 * b * b) + 2 * p2 * a * b]
        return np.asarray(x * radial[:, None] + np.column_stack(tangential))

    def _to_normalized(self, points: Floats) -> Floats:
        y = (points[:, 1] - self.K[1, 2]) / self.K[1, 1]
        return np.column_stack([(points[:, 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0], y])

    def _to_pixels(self, x: Floats) -> Floats:
        return np.asarray(x @ self.K[:2, :2].T + self.K[:2, 2])


@dataclass(frozen=True, eq=False)
class CalibratedViews:
    """Cameras of all views, and points of their scene."""

    cameras: tuple[Camera, ...]  # in the order of the views
    points: Floats  # points of the world, which give the range of disparities; may be empty


def camera_from_matrices(
    name: str, K: Floats, R: Floats, t: Floats, size: tuple[int, int], *, bottom_up: bool = False
) -> Camera:
    """Make a camera from matrices of a file, and check them."""
    values = np.concatenate([K.ravel(), R.ravel(), t])
    _check(name, np.isfinite(values).all(), "a matrix is not finite")
    _check(name, np.abs(values).max() <= LARGEST, f"a matrix has numbers beyond {LARGEST:g}")
    is_valid = np.abs(K[[1, 2, 2], [0, 0, 1]]).max() <= 1e-9 * np.abs(K).max() and K[2, 2] != 0.0
    is_valid = is_valid and min(K[0, 0] * K[2, 2], K[1, 1] * K[2, 2]) > 0.0
    _check(name, is_valid, "K is not upper triangular with positive focal lengths")
    K = np.triu(K / K[2, 2])
    is_valid = min(K[0, 0], K[1, 1]) >= _MIN_FOCAL_PX and max(K[0, 0], K[1, 1]) <= _MAX_FOCAL_PX
    _check(name, is_valid, "no lens has such a focal length")
    u, singular, vt = np.linalg.svd(R)
    _check(name, np.abs(singular - 1.0).max() < 1e-2, "R is not a rotation")
    R = u @ vt
    reflection = 'R is a reflection; if rows are counted upwards, say "rows": "bottom-up"'
    _check(name, np.linalg.det(R) > 0.0, reflection)
    if bottom_up:
        mirror = np.array([1.0, -1.0, 1.0])
        K = K * np.array([[1.0, -1.0, 1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])
        K[1, 2] += size[1] - 1
        R, t = R * mirror * mirror[:, None], t * mirror
    return Camera(name, K, R, t, size)


def _check(name: str, holds: bool | np.bool_, message: str) -> None:
    if not holds:
        raise ConfigError(f"camera of {name}: {message}")


def decomposed(P: Floats) -> tuple[Floats, Floats, Floats]:
    """Decompose a projection matrix into ``P ~ K [R | t]`` (2.2)."""
    if not (np.isfinite(P).all() and P.any()):
        raise ConfigError("a projection matrix is not finite, or zero")
    P = P / np.abs(P).max()
    left = P[:, :3]
    if abs(np.linalg.det(left)) <= 1e-12 * np.linalg.norm(left) ** 3:
        raise ConfigError("a projection matrix has no finite centre")
    P = P * np.sign(np.linalg.det(left))
    K, R = rq(P[:, :3])
    signs = np.sign(np.diag(K))
    K, R = K * signs, R * signs[:, None]
    t = np.linalg.solve(K, P[:, 3])
    return K / K[2, 2], R, t
