"""The damped loop, and the systems that it solves."""

from collections.abc import Callable

import numpy as np
import pytest

from sfm.least_squares import Damping, levenberg_marquardt, solve_damped

Floats = np.ndarray


class Valley:
    """Rosenbrock's function as a sum of two squares."""

    def cost(self, state: Floats) -> float:
        return float((self._residuals(state) ** 2).sum())

    def linearize(self, state: Floats, iteration: int) -> tuple[float, Callable[[float], Floats]]:
        del iteration
        jacobian = np.array([[-20.0 * state[0], 10.0], [-1.0, 0.0]])
        residuals = self._residuals(state)
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residuals
        return self.cost(state), lambda damping: state - solve_damped(normal, slope, damping)

    def converged(self, before: Floats, after: Floats, decrease: float, cost: float) -> bool:
        del before, after, cost
        return decrease == 0.0

    def _residuals(self, state: Floats) -> Floats:
        return np.array([10.0 * (state[1] - state[0] ** 2), 1.0 - state[0]])


@pytest.mark.parametrize("start", [(-1.2, 1.0), (5.0, -5.0), (1.0, 1.0)])
def test_the_minimum_is_found(start: tuple[float, float]) -> None:
    found = levenberg_marquardt(Valley(), np.array(start), Damping(1e-3, 1e-12, 12), 100)
    np.testing.assert_allclose(found, [1.0, 1.0], atol=1e-9)


def test_it_never_gets_worse() -> None:
    start = np.array([-1.2, 1.0])
    costs = [
        Valley().cost(levenberg_marquardt(Valley(), start, Damping(1e-3, 0.0, tries), steps))
        for tries, steps in ((0, 5), (1, 1), (12, 1), (12, 3))
    ]
    assert costs[0] == Valley().cost(start)
    assert costs == sorted(costs, reverse=True)


def test_solve_damped_agrees_with_a_library() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(30, 12))
    matrix, right = rows.T @ rows, rng.normal(size=12)
    np.testing.assert_allclose(solve_damped(matrix, right, 0.0), np.linalg.solve(matrix, right), rtol=1e-9)
    np.testing.assert_array_equal(solve_damped(np.zeros((3, 3)), np.ones(3), 0.1), np.zeros(3))
    ones = np.ones((2, 2))
    np.testing.assert_allclose(ones @ solve_damped(ones, np.full(2, 4.0), 0.0), 4.0)
