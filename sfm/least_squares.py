"""Damped least squares: Levenberg and Marquardt's loop, and its small systems of normal equations."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from dvc.arrays import Floats

TINY = 1e-300
MIN_PIVOT = 1e-13  # relative to the diagonal

State = TypeVar("State")


class LeastSquares(Protocol[State]):
    """A sum of squares to be minimised over states of any type."""

    def cost(self, state: State) -> float:
        """Return the sum, which is not negative; nan if it is undefined."""

    def linearize(self, state: State, iteration: int) -> tuple[float, Callable[[float], State]]:
        """Linearise the squares around a state; weights may change here.

        Parameters
        ----------
        state : State
            Start of a step.
        iteration : int
            Number of earlier steps.

        Returns
        -------
        cost : float
            Sum at the state.
        stepped : callable
            Function from a damping to the state after the step.
        """

    def converged(self, before: State, after: State, decrease: float, cost: float) -> bool:
        """Return whether the step from one state to another, which decreased the cost, is the last."""


@dataclass(frozen=True)
class Damping:
    """Damping of Levenberg-Marquardt steps: it falls tenfold after a step, and rises tenfold for a retry."""

    start: float
    min_factor: float
    num_tries: int


def levenberg_marquardt(
    problem: LeastSquares[State], state: State, damping: Damping, max_iterations: int
) -> State:
    """Minimise a sum of squares by damped steps."""
    factor = damping.start
    for iteration in range(max_iterations):
        cost, stepped = problem.linearize(state, iteration)
        for _ in range(damping.num_tries):
            candidate = stepped(factor)
            new_cost = problem.cost(candidate)
            if new_cost <= cost:
                break
            factor *= 10.0
        else:
            return state
        before, state = state, candidate
        factor = max(0.1 * factor, damping.min_factor)
        if problem.converged(before, state, cost - new_cost, new_cost):
            break
    return state


def normal_matrix(*equations: Floats) -> Floats:
    """Return the matrix of the normal equations of linear equations."""
    products = [np.einsum("ni,nj->ij", rows, rows) for rows in equations]
    return np.asarray(sum(products[1:], products[0]))


def solve_damped(matrix: Floats, right: Floats, damping: float) -> Floats:
    """Solve a damped positive semidefinite system by Cholesky's method."""
    diagonal = np.diag(matrix)
    scale = np.where(diagonal > 0, 1.0 / np.sqrt(np.maximum(diagonal, TINY)), 0.0)
    left = scale[:, None] * matrix * scale
    solution = scale * right
    size = len(left)
    left[np.arange(size), np.arange(size)] += damping
    for k in range(size):
        if left[k, k] <= MIN_PIVOT:
            left[k:, k] = 0.0
            solution[k] = 0.0
            continue
        left[k:, k] /= math.sqrt(left[k, k])
        below = left[k + 1 :, k]
        left[k + 1 :, k + 1 :] -= below[:, None] * below
        solution[k] /= left[k, k]
        solution[k + 1 :] -= below * solution[k]
    for k in range(size - 1, -1, -1):
        if left[k, k] > 0:
            solution[k] = (solution[k] - (left[k + 1 :, k] * solution[k + 1 :]).sum()) / left[k, k]
    return scale * solution
