"""Plain twins of disparity trees: all trees of a small size, and what each costs."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.integer_transforms import level_shapes
from dvc.dibr.disparity.tree_optimisation import LevelCosts

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def coefficient_cost(
    costs: LevelCosts, i: int, j: int, difference: Integers, label: Integers | None
) -> Floats:
    """Return the least of the ways to code a coefficient that differs so much from its prediction."""
    kind = costs.coefficient_kind[i, j]
    zero, constant, slope, jump, tear = costs.coefficients[kind].astype(float)
    with np.errstate(invalid="ignore"):
        linear = np.where(np.isinf(slope), np.inf, constant + slope * np.abs(difference))
    apart = tear * np.abs(difference)
    cost: Floats = np.minimum(np.where(difference == 0, zero, linear), jump)
    cost = np.minimum(cost, linear) + apart
    if label is not None:
        for candidate, merge in zip(costs.candidates[i, j], costs.merges[kind], strict=True):
            if candidate >= 0:
                cost = np.where(label == candidate, np.minimum(cost, merge + apart), cost)
    return cost


def all_trees_l(shape: tuple[int, int], num_labels: int) -> list[Integers]:
    """Return the labels of all levels of all L trees: each (trees, rows, columns), level 0 first."""
    shapes = level_shapes(shape)
    sizes = [rows * columns for rows, columns in shapes]
    every = np.array(list(product(range(num_labels), repeat=sum(sizes))))
    parts = np.split(every, np.cumsum(sizes)[:-1], axis=1)
    return [part.reshape(-1, *size) for part, size in zip(parts, shapes, strict=True)]


def all_trees_s(shape: tuple[int, int], num_labels: int) -> tuple[list[Integers], list[Integers]]:
    """Return the labels and the coefficients of all levels of all S trees whose labels are valid."""
    shapes = level_shapes(shape)
    places = [
        (k, i, j)
        for k, (m, n) in enumerate(shapes[:-1])
        for i in range(m)
        for j in range(n)
        if i % 2 or j % 2
    ]
    values = [range(num_labels)] + [range(1 - num_labels, num_labels)] * len(places)
    every = np.array(list(product(*values)))
    highs = [np.zeros((len(every), *size), np.int64) for size in shapes[:-1]]
    for column, (k, i, j) in enumerate(places):
        highs[k][:, i, j] = every[:, column + 1]
    levels = [every[:, :1, None]]
    for high in reversed(highs):
        levels.append(synthesised_s(levels[-1], high))
    levels = levels[::-1]
    valid = ((levels[0] >= 0) & (levels[0] < num_labels)).all(axis=(1, 2))
    return [level[valid] for level in levels], [high[valid] for high in highs]


def synthesised_s(low: Integers, high: Integers) -> Integers:
    """Undo a level of S by its equations, sample by sample (3.16)."""
    labels = np.zeros(high.shape, np.int64)
    for i in range(0, high.shape[1], 2):
        for j in range(high.shape[2]):
            mean = low[:, i // 2, j // 2]
            if j | 1 < high.shape[2]:
                h = high[:, i, j | 1]
                mean = mean - np.floor_divide(h, 2) + (h if j % 2 == 0 else 0)
            labels[:, i, j] = mean
            if i + 1 < high.shape[1]:
                h = high[:, i + 1, j]
                labels[:, i, j] = mean - np.floor_divide(h, 2) + h
                labels[:, i + 1, j] = mean - np.floor_divide(h, 2)
    return labels


def differences_l(levels: Sequence[Integers], predictions: Sequence[NDArray[np.integer]]) -> list[Integers]:
    """Return the coefficients of L trees, less their predictions."""
    found = []
    for labels, parents, predicted in zip(levels, levels[1:], predictions, strict=False):
        rows, columns = np.indices(labels.shape[1:]) // 2
        found.append(labels - parents[:, rows, columns] - predicted)
    return found


def total_costs(
    errors: Floats,
    levels: Sequence[Integers],
    differences: Sequence[Integers],
    costs: Sequence[LevelCosts],
    lowpass_is_unused: bool,
) -> Floats:
    """Return the cost of each tree: errors, coefficients and flags."""
    rows, columns = np.indices(errors.shape[:2])
    spent = errors[rows, columns, levels[0]]
    flat, same = spent.copy(), np.ones(spent.shape, bool)
    for k, cost in enumerate(costs):
        shape = levels[k + 1].shape
        up, flat_up, same_up = np.zeros(shape), np.zeros(shape), np.ones(shape, bool)
        for i, j in np.ndindex(levels[k].shape[1:]):
            label = None if lowpass_is_unused else levels[k][:, i, j]
            if not lowpass_is_unused or i % 2 or j % 2:
                if not (i % 2 == 0 and lowpass_is_unused and j % 2 == 0):
                    up[:, i // 2, j // 2] += coefficient_cost(cost, i, j, differences[k][:, i, j], label)
                same_up[:, i // 2, j // 2] &= differences[k][:, i, j] == 0
            up[:, i // 2, j // 2] += spent[:, i, j]
            flat_up[:, i // 2, j // 2] += flat[:, i, j]
            same_up[:, i // 2, j // 2] &= same[:, i, j]
        flags = cost.flags[cost.node_kind].astype(float)
        spent = np.minimum(np.where(same_up, flat_up + flags[..., 0], np.inf), up + flags[..., 1])
        flat, same = flat_up, same_up
    totals: Floats = spent.sum(axis=(1, 2))
    return totals


def error_tensor(
    reference: Floats, views: Sequence[Floats], offsets: Sequence[tuple[float, float]], disparities: Floats
) -> Floats:
    """Return (3.31) of rectified gray views, pixel by pixel; what no view sees has the mean error."""
    height, width = reference.shape
    tensor = np.full((height, width, len(disparities)), np.nan)
    for m, n, k in np.ndindex(tensor.shape):
        squares = []
        for view, (a, b) in zip(views, offsets, strict=True):
            y, x = m - b * disparities[k], n - a * disparities[k]
            if 0 <= y <= height - 1 and 0 <= x <= width - 1:
                y0, x0 = min(int(y), max(height - 2, 0)), min(int(x), max(width - 2, 0))
                fy, fx = y - y0, x - x0
                y1, x1 = min(y0 + 1, height - 1), min(x0 + 1, width - 1)
                upper = (1 - fx) * view[y0, x0] + fx * view[y0, x1]
                lower = (1 - fx) * view[y1, x0] + fx * view[y1, x1]
                squares.append(((1 - fy) * upper + fy * lower - reference[m, n]) ** 2)
        if squares:
            tensor[m, n, k] = np.mean(squares) * len(views) / (len(views) + 1)
    blind = np.nanmean(tensor, axis=2, keepdims=True)
    return np.where(np.isnan(tensor), blind, tensor)
