"""The camera of least distances in the image: linear equations, then robust Levenberg-Marquardt steps."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sfm.cameras.alternation import nonzero
from sfm.cameras.camera_prior import MEDIAN_OF_RAYLEIGH, NUM_PARAMETERS, ResectionProblem
from sfm.cameras.projective_basis import projection_equations
from sfm.decompositions import least_singular
from sfm.least_squares import Damping, levenberg_marquardt, normal_matrix, solve_damped

Floats = NDArray[np.float64]

TUKEY_TUNING = 5.5  # of distances in the plane, in standard deviations of a coordinate
MIN_DEPTH = 1e-9  # of a point in the camera
DAMPING = Damping(start=1e-6, min_factor=1e-12, num_tries=8)
TOLERANCE = 1e-12  # change of a camera of unit norm below which a minimum is reached


def image_distances(problem: ResectionProblem, camera: Floats) -> Floats:
    """Measure how far a camera sees points from where they are."""
    p = problem.x @ camera.T
    offset = p[:, :2] / nonzero(p[:, 2], MIN_DEPTH)[:, None] - problem.seen
    distances: Floats = np.hypot(offset[:, 0], offset[:, 1])
    return distances


def robust_weights(problem: ResectionProblem, distances: Floats, redescending: bool) -> tuple[Floats, float]:
    """Weigh points by their distances; virtual ones count by their own uncertainty."""
    real = distances[: problem.num_real]
    free = max(1.0, 2.0 * problem.num_real - NUM_PARAMETERS) / (2.0 * problem.num_real)
    noise = max(problem.min_noise, float(np.median(real)) / (MEDIAN_OF_RAYLEIGH * math.sqrt(free)))
    if redescending:
        robust = np.maximum(0.0, 1.0 - (real / (TUKEY_TUNING * noise)) ** 2) ** 2
    else:
        robust = noise / np.maximum(real, noise)
    weights = problem.weights.copy()
    weights[: problem.num_real] *= robust
    weights[problem.num_real : problem.num_real + problem.num_virtual] *= (noise / problem.sigma) ** 2
    return weights, noise


def linear_camera(problem: ResectionProblem, num_iterations: int) -> Floats:
    """Solve the linear equations of (B.2), reweighted by the denominators and robustly."""
    camera = problem.start
    for _ in range(num_iterations):
        weights, _ = robust_weights(problem, image_distances(problem, camera), redescending=False)
        kappa = 1.0 / np.maximum(np.abs(problem.x @ camera[2]), 1e-3 * np.abs(camera[2]).max())
        scaled = (np.sqrt(weights) * kappa)[:, None] * problem.x
        normal = normal_matrix(*projection_equations(scaled, problem.seen))
        found: Floats = least_singular(normal).reshape(3, 4)
        behind = np.count_nonzero(problem.x @ found[2] < 0)
        camera = -found if 2 * behind > len(problem.x) else found
    return camera


def minimize_distances(problem: ResectionProblem, start: Floats, max_iterations: int) -> Floats:
    """Minimise robust distances in the image, from the better of a start and the prior camera."""
    errors = [np.median(image_distances(problem, c)[: problem.num_real]) for c in (start, problem.start)]
    camera = start if errors[0] <= errors[1] else problem.start
    camera = camera / np.sqrt((camera * camera).sum())
    minimum = _RobustDistances(problem, max_iterations // 2)
    best: Floats = levenberg_marquardt(minimum, camera, DAMPING, max_iterations)[0]
    return best


class _RobustDistances:
    """Weighted squared distances. The weights settle first; then they stay, so that the steps converge."""

    def __init__(self, problem: ResectionProblem, num_reweighted: int) -> None:
        self._problem, self._num_reweighted = problem, num_reweighted
        self._weights = problem.weights

    def cost(self, camera: Floats) -> float:
        return float((self._weights * image_distances(self._problem, camera) ** 2).sum())

    def linearize(self, camera: Floats, iteration: int) -> tuple[float, Callable[[float], Floats]]:
        distances = image_distances(self._problem, camera)
        if iteration < self._num_reweighted:
            self._weights, _ = robust_weights(self._problem, distances, redescending=True)
        p = self._problem.x @ camera.T
        depth = nonzero(p[:, 2], MIN_DEPTH)
        uv = p[:, :2] / depth[:, None]
        root = np.sqrt(self._weights)[:, None]
        errors = root * (uv - self._problem.seen)
        horizontal, vertical = projection_equations(root * self._problem.x / depth[:, None], uv)
        normal = normal_matrix(horizontal, vertical)
        slope = np.einsum("ni,n->i", horizontal, errors[:, 0]) + np.einsum("ni,n->i", vertical, errors[:, 1])

        def stepped(damping: float) -> Floats:
            candidate = camera - solve_damped(normal, slope, damping).reshape(3, 4)
            unit: Floats = candidate / np.sqrt((candidate * candidate).sum())
            return unit

        return float((self._weights * distances * distances).sum()), stepped

    def converged(self, before: Floats, after: Floats, decrease: float, cost: float) -> bool:
        del decrease, cost
        return float(np.abs(after - before).max()) < TOLERANCE
