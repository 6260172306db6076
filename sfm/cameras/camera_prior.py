"""The problem of resection: points that are seen, and those by which a prior camera has its say."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import PixelFrame, homogeneous
from sfm.cameras.projective_basis import CAMERA_NORM
from sfm.least_squares import solve_damped

Floats = NDArray[np.float64]

NUM_PARAMETERS = 11
MEDIAN_OF_RAYLEIGH = 1.1774  # median distance in the plane, in standard deviations of a coordinate


@dataclass(frozen=True)
class PriorSettings:
    """How far a prior camera is trusted."""

    min_noise_px: float = 0.1  # lower bound on the standard deviation of a coordinate of a point
    # bounds on how far the prior camera, moved to fit the points, may be off in the image
    min_sigma_px: float = 1.0
    max_sigma_px: float = 10.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if not 0 < self.min_sigma_px <= self.max_sigma_px:
            raise ValueError(f"`min_sigma_px` must be in (0, max], got {self.min_sigma_px}")


@dataclass(frozen=True, eq=False)
class ExpectedPoints:
    """Where points are expected to be seen by what is known of other instants."""

    points: Floats  # homogeneous points, as `Model.points` has them
    positions: Floats  # image points in pixels
    # what the mean of their squared distances counts, with respect to the mean of those that are seen
    weight: float


@dataclass(frozen=True, eq=False)
class ResectionProblem:
    """Points as (x, y, 1, inverse depth), well scaled, and where they are seen."""

    x: Floats  # scaled points
    seen: Floats  # where they are seen, in normalised units
    weights: Floats  # of the squared distances
    num_real: int  # points that are seen, and points of the prior camera
    num_virtual: int
    to_scaled: Floats  # takes unscaled points
    start: Floats  # the prior camera, moved to fit, for scaled points
    sigma: float  # standard deviation of a virtual point, in normalised units
    min_noise: float  # lower bound on that of a real one

    def with_expected(self, expected: ExpectedPoints, frame: PixelFrame) -> "ResectionProblem":
        """Append points that count together as `expected` says."""
        x = expected.points / expected.points[:, 2:3]
        each = expected.weight * self.num_real / len(x)
        return replace(
            self,
            x=np.vstack([self.x, x @ self.to_scaled.T]),
            seen=np.vstack([self.seen, frame.to_normalized(expected.positions)]),
            weights=np.concatenate([self.weights, np.full(len(x), each)]),
        )


def resection_problem(
    x: Floats, seen: Floats, prior: Floats, frame: PixelFrame, settings: PriorSettings
) -> ResectionProblem:
    """Scale the points, and let a prior camera see virtual points all over the image."""
    min_noise = settings.min_noise_px / frame.scale_px
    middle, spread = x.mean(axis=0), x.std(axis=0)
    size = np.maximum(spread, np.array([0.05, 0.05, 1.0, 1e-6 + 0.02 * abs(middle[3])]))
    to_scaled = np.diag(1.0 / size)
    to_scaled[[0, 1, 3], 2] = -middle[[0, 1, 3]] / size[[0, 1, 3]]
    to_scaled[2, 2] = 1.0
    moved, error = _moved_to_fit(prior, x, seen, min_noise)
    sigma_px = float(np.clip(3.0 * error * frame.scale_px, settings.min_sigma_px, settings.max_sigma_px))
    virtual = _virtual_points(x[:, 3], frame)
    p = virtual @ moved.T
    ahead = p[:, 2] > 1e-3 * CAMERA_NORM
    num_virtual = int(np.count_nonzero(ahead))
    # Many virtual points stand for few parameters.
    each = NUM_PARAMETERS / (2.0 * max(1, num_virtual))
    return ResectionProblem(
        x=np.vstack([x, virtual[ahead]]) @ to_scaled.T,
        seen=np.vstack([seen, p[ahead, :2] / p[ahead, 2:]]),
        weights=np.concatenate([np.ones(len(x)), np.full(num_virtual, each)]),
        num_real=len(x),
        num_virtual=num_virtual,
        to_scaled=to_scaled,
        start=moved @ np.linalg.inv(to_scaled),
        sigma=sigma_px / frame.scale_px,
        min_noise=min_noise,
    )


def _virtual_points(inverse: Floats, frame: PixelFrame) -> Floats:
    """Return points (V, 4) all over the image, nearer and farther than the points of the scene."""
    low, high = float(np.quantile(inverse, 0.05)), float(np.quantile(inverse, 0.95))
    margin = 0.25 * max(abs(low), abs(high)) + 0.25 * (high - low)
    right, bottom = 0.5 * frame.width_px / frame.scale_px, 0.5 * frame.height_px / frame.scale_px
    steps = np.array([-1.0, 0.0, 1.0])
    grid = np.meshgrid(right * steps, bottom * steps, [low - margin, high + margin])
    x, y, depth = (axis.ravel() for axis in grid)
    return np.column_stack([x, y, np.ones_like(x), depth])


def _moved_to_fit(camera: Floats, x: Floats, seen: Floats, least: float) -> tuple[Floats, float]:
    """Move a camera's image by a robust affine map on to the points; also return the error that remains."""
    p = x @ camera.T
    ahead = p[:, 2] > 1e-6
    if np.count_nonzero(ahead) < 4:
        return camera, math.inf
    guess = homogeneous(p[ahead, :2] / p[ahead, 2:])
    target = seen[ahead]
    affine = np.eye(3)
    affine[:2, 2] = np.median(target - guess[:, :2], axis=0)
    error = 0.0
    for _ in range(10):
        offset = target - guess @ affine[:2].T
        distance = np.hypot(offset[:, 0], offset[:, 1])
        error = max(least, float(np.median(distance)) / MEDIAN_OF_RAYLEIGH)
        robust = 1.0 / np.maximum(distance, error)
        normal = np.einsum("n,ni,nj->ij", robust, guess, guess)
        slope = np.einsum("n,ni,nk->ik", robust, guess, offset)
        # Points on a line leave part of the map open: the damping leaves it at the identity.
        affine[0] += solve_damped(normal, slope[:, 0], 1e-6)
        affine[1] += solve_damped(normal, slope[:, 1], 1e-6)
    return affine @ camera, error
