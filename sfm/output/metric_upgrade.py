"""Euclidean approximation of a projective model: what viewers and COLMAP's text format need."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sfm.model import Model

Floats = NDArray[np.float64]

USUAL_FOCAL_LENGTH = 1.2
"""In units of the longer side of the image; what most cameras have."""
PRIOR_WEIGHT = 0.002
"""Weight of the usual focal length and of the plane at infinity as it is: nothing unless undetermined."""


@dataclass(frozen=True, eq=False)
class MetricModel:
    """A Euclidean reconstruction; its unit of length is the distance of the cameras."""

    # focal length shared by both key frames, in pixels; the principal point is the centre
    focal_length_px: float
    second_from_first: Floats  # rotation and translation ``[R | t]`` from the first to the second camera
    points: Floats  # 3D points in the frame of the first camera
    error_px: float  # root mean square reprojection error in the second key frame, in pixels


def metric_upgrade(model: Model) -> MetricModel:
    """Find the plane at infinity and the focal length under which the second camera moved most rigidly."""
    rotation, translation = model.second_camera[:, :3], model.second_camera[:, 3]

    def _residuals(parameters: Floats) -> Floats:
        matrix, focal = _rigid_part(rotation, translation, parameters)
        prior = [np.log(focal / USUAL_FOCAL_LENGTH), *parameters[1:]]
        return np.concatenate([(matrix - _nearest_rotation(matrix)).ravel(), PRIOR_WEIGHT * np.array(prior)])

    start = np.array([np.log(USUAL_FOCAL_LENGTH), 0.0, 0.0, 0.0])
    best = least_squares(_residuals, start, method="lm", max_nfev=2000).x
    matrix, focal = _rigid_part(rotation, translation, best)
    scale = float(np.cbrt(abs(np.linalg.det(rotation - np.outer(translation, best[1:])))))
    shift = translation / (np.array([focal, focal, 1.0]) * max(scale, 1e-12))
    return _assemble(model, best[1:], focal, _nearest_rotation(matrix), shift)


def _rigid_part(rotation: Floats, translation: Floats, parameters: Floats) -> tuple[Floats, float]:
    """Return ``K^-1 (R - t a') K`` at unit determinant, and f."""
    focal = float(np.exp(np.clip(parameters[0], -3.0, 3.0)))
    k = np.array([focal, focal, 1.0])
    matrix = (rotation - np.outer(translation, parameters[1:])) * k[None, :] / k[:, None]
    determinant = abs(float(np.linalg.det(matrix)))
    return matrix / np.cbrt(max(determinant, 1e-12)), focal


def _nearest_rotation(matrix: Floats) -> Floats:
    u, _, vt = np.linalg.svd(matrix)
    rotation: Floats = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation


def _assemble(model: Model, plane: Floats, focal: float, rotation: Floats, shift: Floats) -> MetricModel:
    frame = model.pixel_frame
    rays = model.points[:, :3] / model.depths[:, None]
    depths = model.depths / (1.0 + model.points[:, :3] @ plane)
    points = depths[:, None] * rays / np.array([focal, focal, 1.0])
    length = max(float(np.linalg.norm(shift)), 1e-12)
    points, shift = points / length, shift / length
    seen = points @ rotation.T + shift
    with np.errstate(divide="ignore", invalid="ignore"):
        second = frame.to_pixels(focal * seen[:, :2] / seen[:, 2:])
    error = np.linalg.norm(second - model.correspondences.second, axis=1)
    error = error[np.isfinite(error)]
    return MetricModel(
        focal * frame.scale_px,
        np.column_stack([rotation, shift]),
        points,
        float(np.sqrt(np.mean(error**2))) if error.size else 0.0,
    )
