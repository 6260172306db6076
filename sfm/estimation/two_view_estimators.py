"""Estimators of fundamental matrices and homographies from points, and the least Sampson distance."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dvc.arrays import Floats, Integers, Mask
from dvc.geometry.cameras import homogeneous
from sfm.decompositions import least_singular, real_roots, right_singular, svd
from sfm.estimation.epipolar import TINY, skew, unit_norm
from sfm.least_squares import Damping, levenberg_marquardt, normal_matrix

TOLERANCE = 1e-12
"""Relative decrease of the cost at a minimum."""
DAMPING = Damping(start=1e-4, min_factor=0.0, num_tries=8)


class TwoViewEstimator:
    """Points of two images, each moved to have its centroid at 0, and both scaled alike."""

    def __init__(self, first: Floats, second: Floats) -> None:
        self.num_data, self.scale_px = len(first), 1.0
        self._first_px, self._second_px = np.zeros(2), np.zeros(2)
        if len(first):
            a, b = self._first_px, self._second_px = first.mean(axis=0), second.mean(axis=0)
            spread = math.sqrt(0.25 * float((((first - a) ** 2) + (second - b) ** 2).sum(axis=1).mean()))
            self.scale_px = spread if spread > 1e-9 else 1.0
        self.first = (first - self._first_px) / self.scale_px
        self.second = (second - self._second_px) / self.scale_px

    def matrices(self) -> tuple[Floats, Floats]:
        """Return the homographies (3, 3) from pixels to these coordinates, for both images."""
        s = 1.0 / self.scale_px
        a, b = np.diag([s, s, 1.0]), np.diag([s, s, 1.0])
        a[:2, 2], b[:2, 2] = -s * self._first_px, -s * self._second_px
        return a, b


class HomographyEstimator(TwoViewEstimator):
    """Homographies, one for each sample of four points or more."""

    min_num_samples = 4

    def __init__(self, first: Floats, second: Floats) -> None:
        super().__init__(first, second)
        a, zero = homogeneous(self.first), np.zeros((self.num_data, 3))
        horizontal = np.hstack([a, zero, -self.second[:, :1] * a])
        vertical = np.hstack([zero, a, -self.second[:, 1:] * a])
        self._rows = np.stack([horizontal, vertical], axis=1)

    def estimate(self, samples: Integers) -> Floats:
        """Solve many samples at once."""
        rows = self._rows[samples].reshape(len(samples), 2 * samples.shape[1], 9)
        return least_singular(rows).reshape(-1, 3, 3)

    def residuals(self, models: Floats) -> Floats:
        """Measure the Sampson distances of all correspondences under all models."""
        x, y = self.first[:, 0], self.first[:, 1]
        h = models.reshape(-1, 9, 1)
        a, b, c = (h[:, k] * x + h[:, k + 1] * y + h[:, k + 2] for k in (0, 3, 6))
        depth = np.where(np.abs(c) > 1e-9, c, 1e-9)
        u, v = a / depth, b / depth
        # J is the derivative of (u, v) by (x, y); the offset d has the covariance I + J J'.
        jux, juy = (h[:, 0] - u * h[:, 6]) / depth, (h[:, 1] - u * h[:, 7]) / depth
        jvx, jvy = (h[:, 3] - v * h[:, 6]) / depth, (h[:, 4] - v * h[:, 7]) / depth
        uu, vv, uv = 1 + jux * jux + juy * juy, 1 + jvx * jvx + jvy * jvy, jux * jvx + juy * jvy
        du, dv = self.second[:, 0] - u, self.second[:, 1] - v
        squared = (vv * du * du - 2 * uv * du * dv + uu * dv * dv) / np.maximum(uu * vv - uv * uv, 1.0)
        return np.sqrt(np.maximum(squared, 0.0)) * self.scale_px

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Fit the inliers by linear least squares, reweighted to minimise distances in the image."""
        points = homogeneous(self.first[inliers])
        for _ in range(3):
            depth = points @ model[2]
            weight = 1.0 / np.maximum(np.abs(depth), 1e-6)
            rows = self._rows[inliers] * weight[:, None, None]
            normal = np.einsum("nki,nkj->ij", rows, rows)
            model = least_singular(normal).reshape(3, 3)
        return model


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
    problem = SampsonProblem(first, second)
    return levenberg_marquardt(problem, problem.at(best), DAMPING, max_iterations).fundamental


class SampsonState(NamedTuple):
    """F, and the signed Sampson distances (N,) with their derivatives (N, 9) by the entries of F."""

    fundamental: Floats
    distances: Floats
    gradient: Floats


class SampsonProblem:
    """The sum of squared Sampson distances, as a problem of least squares."""

    def __init__(self, first: Floats, second: Floats) -> None:
        self._first, self._second = first, second
        self._rows = constraint_rows(first, second)

    def at(self, fundamental: Floats) -> SampsonState:
        """Return the distances under a matrix, with their derivatives."""
        first, second = self._first, self._second
        a = first @ fundamental[:, :2].T + fundamental[:, 2]
        b = second @ fundamental[:2] + fundamental[2]
        squares = (a[:, :2] ** 2).sum(axis=1) + (b[:, :2] ** 2).sum(axis=1)
        inverse = 1.0 / np.sqrt(np.maximum(squares, TINY))
        distances: Floats = ((second * a[:, :2]).sum(axis=1) + a[:, 2]) * inverse
        gradient = self._rows * inverse[:, None]
        pull = -distances * inverse * inverse
        pa, pb = pull[:, None] * a[:, :2], pull[:, None] * b[:, :2]
        for i in range(2):
            gradient[:, 3 * i : 3 * i + 2] += pa[:, i, None] * first
            gradient[:, 3 * i + 2] += pa[:, i]
            gradient[:, i] += pb[:, i] * second[:, 0]
            gradient[:, 3 + i] += pb[:, i] * second[:, 1]
            gradient[:, 6 + i] += pb[:, i]
        return SampsonState(fundamental, distances, gradient)

    def cost(self, state: SampsonState) -> float:
        """Return the sum of squared distances."""
        return float((state.distances * state.distances).sum())

    def linearize(self, state: SampsonState, iteration: int) -> tuple[float, Callable[[float], SampsonState]]:
        """Linearise by the seven parameters of `turned`."""
        del iteration
        jacobian = state.gradient @ tangent_space(state.fundamental)
        normal = normal_matrix(jacobian)
        slope = np.einsum("n,ni->i", state.distances, jacobian)

        def stepped(damping: float) -> SampsonState:
            values, rows = right_singular(normal)
            top = max(float(values[0]), TINY)
            # No step in directions without curvature.
            step = ((rows @ slope) / (np.maximum(values, 1e-15 * top) + damping * top)) @ rows
            return self.at(turned(state.fundamental, -step))

        return self.cost(state), stepped

    def converged(self, before: SampsonState, after: SampsonState, decrease: float, cost: float) -> bool:
        """Return whether the cost hardly decreased."""
        del before, after
        return decrease <= TOLERANCE * cost


def tangent_space(fundamental: Floats) -> Floats:
    """Return the derivatives (9, 7) of the entries of F by the parameters of a step of `turned`."""
    u, s, vt = svd(fundamental)
    diagonal = np.diag([s[0], s[1], 0.0])
    columns = [u @ skew(axis) @ diagonal @ vt for axis in np.eye(3)]
    columns += [-u @ diagonal @ skew(axis) @ vt for axis in np.eye(3)]
    columns.append(u @ np.diag([-s[1], s[0], 0.0]) @ vt)
    return np.stack([column.ravel() for column in columns], axis=1)


def turned(fundamental: Floats, step: Floats) -> Floats:
    """Turn U by the first three and V by the next three parameters, and shift p by the last."""
    u, s, vt = svd(fundamental)
    angle = math.atan2(s[1], s[0]) + step[6]
    diagonal = np.array([math.cos(angle), math.sin(angle), 0.0])
    return np.asarray((u @ _rotation(step[:3]) * diagonal) @ (_rotation(step[3:6]).T @ vt))


def _rotation(vector: Floats) -> Floats:
    """Return the rotation about a vector, by the Cayley transform: orthogonal, no special case at 0."""
    half = skew(0.5 * vector)
    return np.linalg.solve(np.eye(3) - half, np.eye(3) + half).astype(np.float64)


class FundamentalEstimator(TwoViewEstimator):
    """Fundamental matrices; seven points have one or three, more points one, all of rank 2."""

    min_num_samples = 7

    def estimate(self, samples: Integers) -> Floats:
        """Solve many samples at once."""
        rows = constraint_rows(self.first, self.second)[samples]
        if samples.shape[1] == self.min_num_samples:
            return seven_point(rows)
        solution = least_singular(rows).reshape(-1, 3, 3)
        last = least_singular(solution)[:, :, None]
        models = solution - (solution @ last) @ last.transpose(0, 2, 1)
        return np.asarray(models / np.maximum(np.linalg.norm(models, axis=(1, 2)), TINY)[:, None, None])

    def to_pixels(self, fundamental: Floats) -> Floats:
        """Convert a fundamental matrix to pixels."""
        a, b = self.matrices()
        return unit_norm(b.T @ fundamental @ a)

    def residuals(self, models: Floats) -> Floats:
        """Measure the Sampson distances of all correspondences under all models."""
        x, y = self.first[:, 0], self.first[:, 1]
        u, v = self.second[:, 0], self.second[:, 1]
        f = models.reshape(-1, 9, 1)
        a, b, c = (f[:, k] * x + f[:, k + 1] * y + f[:, k + 2] for k in (0, 3, 6))
        d, e = (f[:, k] * u + f[:, k + 3] * v + f[:, k + 6] for k in (0, 1))
        squared_gradient = a * a + b * b + d * d + e * e
        distances: Floats = np.abs(u * a + v * b + c) / np.sqrt(np.maximum(squared_gradient, TINY))
        return distances * self.scale_px

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Minimise the sum of squared Sampson distances of the inliers."""
        return minimize_sampson(model, self.first[inliers], self.second[inliers], max_iterations=5)


def seven_point(rows: Floats) -> Floats:
    """Return the matrices of rank 2 that satisfy seven equations."""
    null = right_singular(rows)[1][:, 7:].reshape(-1, 2, 3, 3)
    a, b = null[:, 0], null[:, 1]
    # det(z a + b) is a cubic in z: its outer coefficients are determinants, the rest follows from z = 1, -1.
    c3, c0 = _determinants(a), _determinants(b)
    plus, minus = _determinants(a + b), _determinants(b - a)
    c2, c1 = 0.5 * (plus + minus) - c0, 0.5 * (plus - minus) - c3
    usable = np.abs(c3) > 1e-12 * (np.abs(c2) + np.abs(c1) + np.abs(c0) + TINY)
    a, b, c3 = a[usable], b[usable], c3[usable]
    roots = real_roots(np.stack([c0[usable], c1[usable], c2[usable], c3], axis=1))
    sample, which = np.nonzero(np.isfinite(roots))
    z = roots[sample, which][:, None, None]
    models = z * a[sample] + b[sample]
    return np.asarray(models / np.linalg.norm(models, axis=(1, 2))[:, None, None])


def _determinants(m: Floats) -> Floats:
    determinant: Floats = (
        m[:, 0, 0] * (m[:, 1, 1] * m[:, 2, 2] - m[:, 1, 2] * m[:, 2, 1])
        - m[:, 0, 1] * (m[:, 1, 0] * m[:, 2, 2] - m[:, 1, 2] * m[:, 2, 0])
        + m[:, 0, 2] * (m[:, 1, 0] * m[:, 2, 1] - m[:, 1, 1] * m[:, 2, 0])
    )
    return determinant
