"""The fundamental matrix of rank 2 with the least Sampson distance, by Levenberg-Marquardt steps."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfm.decompositions import right_singular, svd
from sfm.estimation.epipolar import TINY, skew, unit_norm
from sfm.least_squares import Damping, levenberg_marquardt, normal_matrix

Floats = NDArray[np.float64]

TOLERANCE = 1e-12  # relative decrease of the cost below which a minimum is reached


def constraint_rows(first: Floats, second: Floats) -> Floats:
    """Write ``x1' F x0 = 0`` as a linear equation in the nine entries of F."""
    ones = np.ones((len(first), 1))
    a, b = np.hstack([first, ones]), np.hstack([second, ones])
    return (b[:, :, None] * a[:, None, :]).reshape(len(first), 9)


def minimize_sampson(fundamental: Floats, first: Floats, second: Floats, max_iterations: int = 20) -> Floats:
    """Minimise the sum of squared Sampson distances."""
    u, s, vt = svd(fundamental)
    best = unit_norm((u * np.array([s[0], s[1], 0.0])) @ vt)
    if len(first) < 7 or not s[0] > 0:
        return best
    problem = _SampsonProblem(first, second)
    damping = Damping(start=1e-4, min_factor=0.0, num_tries=8)
    return levenberg_marquardt(problem, problem.at(best), damping, max_iterations)[0].fundamental


class _State(NamedTuple):
    """F, and the signed Sampson distances (N,) with their derivatives (N, 9) by the entries of F."""

    fundamental: Floats
    distances: Floats
    gradient: Floats


class _SampsonProblem:
    def __init__(self, first: Floats, second: Floats) -> None:
        self._first, self._second = first, second
        self._rows = constraint_rows(first, second)

    def at(self, fundamental: Floats) -> _State:
        return _State(fundamental, *_sampson_gradient(fundamental, self._first, self._second, self._rows))

    def cost(self, state: _State) -> float:
        return float((state.distances * state.distances).sum())

    def linearize(self, state: _State, iteration: int) -> tuple[float, Callable[[float], _State]]:
        del iteration
        jacobian = state.gradient @ _tangent_space(state.fundamental)
        normal = normal_matrix(jacobian)
        slope = np.einsum("n,ni->i", state.distances, jacobian)

        def stepped(damping: float) -> _State:
            return self.at(_turned(state.fundamental, -_solve(normal, slope, damping)))

        return self.cost(state), stepped

    def converged(self, before: _State, after: _State, decrease: float, cost: float) -> bool:
        del before, after
        return decrease <= TOLERANCE * cost


def _solve(normal: Floats, slope: Floats, damping: float) -> Floats:
    """Solve the damped normal equations; directions without any curvature are left alone."""
    values, rows = right_singular(normal)
    top = max(float(values[0]), TINY)
    solution: Floats = ((rows @ slope) / (np.maximum(values, 1e-15 * top) + damping * top)) @ rows
    return solution


def _sampson_gradient(
    fundamental: Floats, first: Floats, second: Floats, rows: Floats
) -> tuple[Floats, Floats]:
    """Return signed Sampson distances (N,) and their derivatives (N, 9) by the entries of F."""
    a = first @ fundamental[:, :2].T + fundamental[:, 2]
    b = second @ fundamental[:2] + fundamental[2]
    inverse = 1.0 / np.sqrt(np.maximum((a[:, :2] ** 2).sum(axis=1) + (b[:, :2] ** 2).sum(axis=1), TINY))
    distances: Floats = ((second * a[:, :2]).sum(axis=1) + a[:, 2]) * inverse
    gradient = rows * inverse[:, None]
    pull = -distances * inverse * inverse
    pa, pb = pull[:, None] * a[:, :2], pull[:, None] * b[:, :2]
    for i in range(2):
        gradient[:, 3 * i] += pa[:, i] * first[:, 0]
        gradient[:, 3 * i + 1] += pa[:, i] * first[:, 1]
        gradient[:, 3 * i + 2] += pa[:, i]
        gradient[:, i] += pb[:, i] * second[:, 0]
        gradient[:, 3 + i] += pb[:, i] * second[:, 1]
        gradient[:, 6 + i] += pb[:, i]
    return distances, gradient


def _tangent_space(fundamental: Floats) -> Floats:
    """Return the derivatives (9, 7) of the entries of F by the parameters of a step of `_turned`."""
    u, s, vt = svd(fundamental)
    diagonal = np.diag([s[0], s[1], 0.0])
    columns = [u @ skew(axis) @ diagonal @ vt for axis in np.eye(3)]
    columns += [-u @ diagonal @ skew(axis) @ vt for axis in np.eye(3)]
    columns.append(u @ np.diag([-s[1], s[0], 0.0]) @ vt)
    return np.stack([column.ravel() for column in columns], axis=1)


def _turned(fundamental: Floats, step: Floats) -> Floats:
    """Turn U by the first three and V by the next three parameters, and shift p by the last."""
    u, s, vt = svd(fundamental)
    angle = math.atan2(s[1], s[0]) + step[6]
    diagonal = np.array([math.cos(angle), math.sin(angle), 0.0])
    turned: Floats = (u @ _rotation(step[:3]) * diagonal) @ (_rotation(step[3:6]).T @ vt)
    return turned


def _rotation(vector: Floats) -> Floats:
    """Return the rotation about a vector, by the Cayley transform: orthogonal, no special case at 0."""
    half = skew(0.5 * vector)
    rotation: Floats = np.linalg.solve(np.eye(3) - half, np.eye(3) + half).astype(np.float64)
    return rotation
