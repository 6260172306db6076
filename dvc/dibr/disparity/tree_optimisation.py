"""Best wavelet coefficients of a disparity map for their bits, by dynamic programming on their tree.

From the leaves up, the least cost of the subtree of a node is found for each of its labels; back from the
roots, the coefficients that reach it: the exact optimum for the given costs ([Maitre2008] Eqs. (3.19) to
(3.32), (3.36)). A zero tree, with all coefficients as predicted, is one more way for a node to have a label.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.dibr.disparity._kernels import NUM_CANDIDATES
from dvc.dibr.disparity.disparity_codec import Tensor
from dvc.dibr.disparity.integer_transforms import (
    S_TRANSFORM,
    IntegerTransform,
    Labels,
    WaveletTree,
    level_shapes,
)

Float32s = NDArray[np.float32]
Kinds = NDArray[np.uint8]

INF = np.float32(np.inf)
ZERO_LABEL: Any = np.int64(0)  # no literal, for which numba would compile
ZERO_ERROR: Any = np.float32(0.0)
ZERO, NONZERO, SLOPE, JUMP, TEAR = range(5)
"""Columns of `LevelCosts.coefficients`."""


class LevelCosts(NamedTuple):
    """Costs of the coefficients and flags of one level, in units of the errors; infinite costs forbid."""

    coefficient_kind: Kinds  # kind of each coefficient
    # (kinds, 5): cost of a coefficient as predicted; constant and slope of a cost linear in its distance from
    # that; cost of any value; and a slope that is added to these three and to `merges`. The first is not
    # above the sum of the next two
    coefficients: Float32s
    node_kind: Kinds  # kind of each node of the next level
    flags: Float32s  # (kinds, 2): cost of a node without coefficients below it, and with
    merges: Float32s  # (kinds, 2): cost of a coefficient that leads to one of `candidates` (L only)
    candidates: Labels  # labels of neighbours, or -1


def optimise_tree(
    transform: IntegerTransform,
    tensor: Tensor,
    costs: Sequence[LevelCosts],
    previous: WaveletTree | None = None,
) -> tuple[WaveletTree, float]:
    """Return the tree of least errors and costs, and their sum."""
    shapes = level_shapes((tensor.shape[0], tensor.shape[1]), len(costs))
    predictions = [np.zeros(shape, np.int32) for shape in shapes[:-1]] if previous is None else previous.highs
    levels = list(zip(predictions, costs, strict=True))
    is_s = transform is S_TRANSFORM
    # least errors of the labels of all nodes of a level; errors if all coefficients below are as predicted
    pyramid, total = [(tensor, tensor)], 0.0
    for level, shape in zip(levels, shapes[1:], strict=True):
        errors, flat = (np.empty((*shape, tensor.shape[2]), np.float32) for _ in range(2))
        total += pass_up(*pyramid[-1], *level, is_s, errors, flat)
        pyramid.append((errors, flat))
    parents = roots = pyramid[-1][0].argmin(axis=2).astype(np.int32)
    total += float(pyramid[-1][0].min(axis=2).sum(dtype=np.float64))
    alive, highs = np.ones(roots.shape, np.bool_), []
    pass_down: Any = pass_down_s if is_s else pass_down_l
    for below, level, shape in reversed(list(zip(pyramid, levels, shapes, strict=False))):
        labels, live, high = np.empty(shape, np.int32), np.empty(shape, np.bool_), np.zeros(shape, np.int32)
        pass_down(*below, *level, parents, alive, high, labels, live)
        highs.append(high)
        parents, alive = labels, live
    return WaveletTree(transform, tensor.shape[2], roots, tuple(highs[::-1])), total


@kernel
def distance_transform(values, slope, transformed):
    """Write the lower envelope of cones with a slope at all values, in two passes; may work in place."""
    labels = values.shape[0]
    running = transformed[0] = values[0]
    for d in range(1, labels):
        running = running + slope
        running = min(running, values[d])
        transformed[d] = running
    for d in range(labels - 2, -1, -1):
        running = running + slope
        running = min(running, transformed[d])
        transformed[d] = running


@kernel
def add_child_l(values, prediction, level, i, j, work, full):
    """Add to `full` the cost of the best coefficient of a child, for each label of its parent."""
    kind, candidates = level.coefficient_kind[i, j], level.candidates[i, j]
    cost, merge, transformed, loose = level.coefficients[kind], level.merges[kind], work[0], work[1]
    labels = values.shape[0]
    tear = cost[TEAR]
    slope = cost[SLOPE] + tear
    is_linear = cost[NONZERO] < INF
    if is_linear:
        distance_transform(values, slope, transformed)
    is_loose = cost[JUMP] < INF
    for d in range(labels):
        loose[d] = values[d] + cost[JUMP]
    for c in range(NUM_CANDIDATES):
        if candidates[c] >= 0 and merge[c] < INF:
            loose[candidates[c]] = min(loose[candidates[c]], values[candidates[c]] + merge[c])
            is_loose = True
    if is_loose:
        distance_transform(loose, tear, loose)
    for d in range(labels):
        shifted = d + prediction
        inside = min(max(shifted, 0), labels - 1)
        beyond = np.float32(abs(shifted - inside))
        best = loose[inside] + tear * beyond
        if shifted == inside:
            best = min(best, values[shifted] + cost[ZERO])
        if is_linear:
            best = min(best, transformed[inside] + slope * beyond + cost[NONZERO])
        full[d] += best


@kernel
def join(full, flat, flags, values):
    """Choose between no coefficients below a node and some; return the offset subtracted from both."""
    least = INF
    for d in range(full.shape[0]):
        values[d] = min(flat[d] + flags[0], full[d] + flags[1])
        least = min(least, values[d])
    for d in range(full.shape[0]):
        values[d] -= least
        flat[d] -= least
    return least


@kernel
def step_cost(cost, magnitude):
    """Return the cost of a coefficient that is not as predicted, without labels of neighbours."""
    step = np.float32(magnitude)
    return min(cost[NONZERO] + cost[SLOPE] * step, cost[JUMP]) + cost[TEAR] * step


@kernel
def best_child_l(values, predicted, level, i, j):
    """Return the best label of a child for its prediction, and its cost."""
    labels, kind, candidates = values.shape[0], level.coefficient_kind[i, j], level.candidates[i, j]
    cost, merge = level.coefficients[kind], level.merges[kind]
    best = INF
    label = 0
    if 0 <= predicted < labels:
        best, label = values[predicted] + cost[ZERO], predicted
    for c in range(NUM_CANDIDATES):
        if candidates[c] >= 0:
            label_cost = values[candidates[c]] + merge[c]
            label_cost += cost[TEAR] * np.float32(abs(candidates[c] - predicted))
            if label_cost < best:
                best, label = label_cost, np.int64(candidates[c])
    if cost[NONZERO] < INF or cost[JUMP] < INF:
        for d in range(labels):
            step = step_cost(cost, abs(d - predicted))
            if values[d] + step < best:
                best, label = values[d] + step, d
    return label, best


@kernel
def combine_s(first, second, prediction, cost, floor, low):
    """Set the low-pass errors of two samples (3.29): the best difference for each mean, small ones first."""
    labels = low.shape[0]
    low[:] = INF
    limit = labels + abs(prediction)
    for magnitude in range(limit):
        step = cost[ZERO] if magnitude == 0 else step_cost(cost, magnitude)
        if magnitude > 0 and not step < INF:
            break
        if magnitude > abs(prediction) and magnitude % 8 == 0:
            highest = np.float32(0.0)
            for d in range(labels):
                highest = max(highest, low[d])
            if step + floor >= highest:
                break
        for side in range(1 if magnitude == 0 else 2):
            high = prediction + (magnitude if side == 0 else -magnitude)
            down = high >> 1
            up = high - down
            # S_0 = d + up and S_1 = d - down
            begin, end = max(0, -up, down), min(labels, labels - up, labels + down)
            for d in range(begin, end):
                error = first[d + up] + second[d - down] + step
                low[d] = error if error < low[d] else low[d]


@kernel
def best_s(first, second, low, prediction, cost):
    """Return the best difference of two samples with a given mean, and its cost."""
    labels = first.shape[0]
    best, chosen = INF, prediction
    down = prediction >> 1
    if 0 <= low + prediction - down < labels and 0 <= low - down < labels:
        best = first[low + prediction - down] + second[low - down] + cost[ZERO]
    for high in range(-labels + 1, labels):
        down = high >> 1
        if 0 <= low + high - down < labels and 0 <= low - down < labels and high != prediction:
            step = step_cost(cost, abs(high - prediction))
            error = first[low + high - down] + second[low - down] + step
            if error < best:
                best, chosen = error, high
    return chosen, best


@kernel
def columns_s(values, predictions, level, m, n, columns):
    """Set the low-pass errors of the columns below a node; return the number of columns."""
    height, width, _labels = values.shape
    count = min(2, width - 2 * n)
    for c in range(count):
        i, j = 2 * m, 2 * n + c
        if i + 1 < height:
            cost = level.coefficients[level.coefficient_kind[i + 1, j]]
            combine_s(values[i, j], values[i + 1, j], predictions[i + 1, j], cost, ZERO_ERROR, columns[c])
        else:
            for d in range(values.shape[2]):
                columns[c, d] = values[i, j, d]
    return count


@kernel
def flat_s(flat, predictions, m, n, low, total):
    """Set errors of a node for labels from `low` on if all its coefficients are as predicted."""
    height, width, labels = flat.shape
    for d in range(low, low + total.shape[0]):
        error = np.float32(0.0)
        for c in range(min(2, width - 2 * n)):
            column = np.int64(d)
            if 2 * n + 1 < width:
                high = predictions[2 * m, 2 * n + 1]
                column = d - (high >> 1) + (high if c == 0 else 0)
            for r in range(min(2, height - 2 * m)):
                shifted = column
                if 2 * m + 1 < height:
                    high = predictions[2 * m + 1, 2 * n + c]
                    shifted = column - (high >> 1) + (high if r == 0 else 0)
                error += flat[2 * m + r, 2 * n + c, shifted] if 0 <= shifted < labels else INF
        total[d - low] = error


@kernel
def pass_up(values, flat, predictions, level, is_s, up, flat_up):
    """Run one level of the bottom-up pass (3.28), (3.29); return the offset subtracted from all nodes."""
    height, width, labels = values.shape
    work, full = np.empty((2, labels), np.float32), np.empty(labels, np.float32)
    total = 0.0
    for m in range(up.shape[0]):
        for n in range(up.shape[1]):
            below, flag = flat_up[m, n], level.flags[level.node_kind[m, n]]
            splits = flag[1] < INF
            full[:] = 0.0
            if not is_s:
                below[:] = 0.0
                for i in range(2 * m, min(2 * m + 2, height)):
                    for j in range(2 * n, min(2 * n + 2, width)):
                        predicted = predictions[i, j]
                        if splits:
                            add_child_l(values[i, j], predicted, level, i, j, work, full)
                        first, end = max(0, -predicted), min(labels, labels - predicted)
                        below[:first] = INF
                        below[end:] = INF
                        for d in range(first, end):
                            below[d] += flat[i, j, d + predicted]
            else:
                flat_s(flat, predictions, m, n, ZERO_LABEL, below)
                if splits and columns_s(values, predictions, level, m, n, work) == 2:
                    cost = level.coefficients[level.coefficient_kind[2 * m, 2 * n + 1]]
                    least, other = work[0, 0], work[1, 0]
                    for d in range(labels):
                        least, other = min(least, work[0, d]), min(other, work[1, d])
                    high = predictions[2 * m, 2 * n + 1]
                    combine_s(work[0], work[1], high, cost, least + other, full)
                elif splits:
                    for d in range(labels):
                        full[d] = work[0, d]
            total += join(full, below, flag, up[m, n])
    return total


@kernel
def pass_down_l(values, flat, predictions, level, parents, alive, highs, labels, live):
    """Run one level of back-tracking: set coefficients, and labels of the children."""
    height, width, num_labels = values.shape
    chosen = np.zeros((2, 2), np.int64)
    for m in range(parents.shape[0]):
        for n in range(parents.shape[1]):
            flag = level.flags[level.node_kind[m, n]]
            splits = False
            if alive[m, n] and flag[1] < INF:
                full, below = flag[1], flag[0]
                for i in range(2 * m, min(2 * m + 2, height)):
                    for j in range(2 * n, min(2 * n + 2, width)):
                        predicted = parents[m, n] + predictions[i, j]
                        label, cost = best_child_l(values[i, j], predicted, level, i, j)
                        chosen[i - 2 * m, j - 2 * n] = label
                        full += cost
                        below += flat[i, j, predicted] if 0 <= predicted < num_labels else INF
                splits = full < below
            for i in range(2 * m, min(2 * m + 2, height)):
                for j in range(2 * n, min(2 * n + 2, width)):
                    predicted = parents[m, n] + predictions[i, j]
                    labels[i, j] = chosen[i - 2 * m, j - 2 * n] if splits else predicted
                    highs[i, j] = labels[i, j] - parents[m, n]
                    live[i, j] = splits


@kernel
def pass_down_s(values, flat, predictions, level, parents, alive, highs, labels, live):
    """Run one level of back-tracking: set coefficients, and labels of the children."""
    height, width, num_labels = values.shape
    columns, below = np.empty((2, num_labels), np.float32), np.empty(1, np.float32)
    for m in range(parents.shape[0]):
        for n in range(parents.shape[1]):
            flag, low = level.flags[level.node_kind[m, n]], np.int64(parents[m, n])
            splits, horizontal = False, np.int64(0)
            if 2 * n + 1 < width:
                horizontal = np.int64(predictions[2 * m, 2 * n + 1])
            if alive[m, n] and flag[1] < INF:
                flat_s(flat, predictions, m, n, low, below)
                if columns_s(values, predictions, level, m, n, columns) == 2:
                    cost = level.coefficients[level.coefficient_kind[2 * m, 2 * n + 1]]
                    high, full = best_s(columns[0], columns[1], low, horizontal, cost)
                else:
                    high, full = horizontal, columns[0, low]
                splits = full + flag[1] < below[0] + flag[0]
                horizontal = high if splits else horizontal
            if 2 * n + 1 < width:
                highs[2 * m, 2 * n + 1] = horizontal
            for c in range(min(2, width - 2 * n)):
                i, j = 2 * m, 2 * n + c
                column = low
                if 2 * n + 1 < width:
                    column = low - (horizontal >> 1) + (horizontal if c == 0 else 0)
                labels[i, j], live[i, j] = column, splits
                if i + 1 < height:
                    high = np.int64(predictions[i + 1, j])
                    if splits:
                        cost = level.coefficients[level.coefficient_kind[i + 1, j]]
                        high, _ = best_s(values[i, j], values[i + 1, j], column, high, cost)
                    highs[i + 1, j] = high
                    labels[i, j], labels[i + 1, j] = column - (high >> 1) + high, column - (high >> 1)
                    live[i + 1, j] = splits
