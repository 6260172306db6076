"""Compiled loops of disparity trees; described by their callers.

Pictures are float32 (rows, columns, channels), tensors float32 (rows, columns, labels), maps of labels and
coefficients int32. `costs` (kinds, 5) holds what a coefficient costs when it is as predicted, the constant
and the slope over its magnitude when not, the cost of any value, and what each label of difference costs
whatever the way; `merge` what a label of a neighbour
costs, and `flags` (kinds, 2) that of a node without and with coefficients below. INF forbids.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.binarisation import NUM_EXPONENTS as BINARY_EXPONENTS
from dvc.entropy.binarisation import code_exp_golomb
from dvc.entropy.mixing import Mixture, code_adaptive, code_mixed, learn
from dvc.entropy.range_coder import FAILED, code_decision

INF = np.float32(np.inf)
ZERO, NONZERO, SLOPE, JUMP, TEAR = range(5)
NUM_CANDIDATES = 2
NONE = -1  # instead of the label of a candidate


class Costs(NamedTuple):
    """What coefficients and flags of a level cost, and the kinds of all."""

    predictions: NDArray[np.int32]
    kinds: NDArray[np.uint8]  # of coefficients
    coefficients: NDArray[np.float32]
    node_kinds: NDArray[np.uint8]
    flags: NDArray[np.float32]
    merge: NDArray[np.float32]
    candidates: NDArray[np.int32]


class Errors(NamedTuple):
    """Least errors of the labels of all nodes of a level."""

    values: NDArray[np.float32]
    flat: NDArray[np.float32]  # where all coefficients below are as predicted


class Nodes(NamedTuple):
    """Labels of the nodes of a level, and which may have coefficients below that are not as predicted."""

    labels: NDArray[np.int32]
    alive: NDArray[np.generic]  # of either type


class Around(NamedTuple):
    """What the neighbours of a sample or node say; work space."""

    counts: NDArray[np.int64]  # how many differ `LITTLE` from the prediction, and how many more
    lean: NDArray[np.int64]  # to which side, of shape (1,)
    candidates: NDArray[np.int64]  # their labels


# ---- error tensor ----

MARGIN = 1e-6  # px, by which positions may lie outside for rounding


@kernel
def add_squared_errors(target, view, homographies, tensor, count):
    """Add the squared errors of one view at every label, and count where it sees the pixel."""
    height, width, channels = view.shape
    share = np.float32(1.0 / channels)
    labels = tensor.shape[2]
    for m in range(tensor.shape[0]):
        for n in range(tensor.shape[1]):
            for k in range(labels):
                h = homographies[k]
                x = h[0, 0] * n + h[0, 1] * m + h[0, 2]
                y = h[1, 0] * n + h[1, 1] * m + h[1, 2]
                z = h[2, 0] * n + h[2, 1] * m + h[2, 2]
                if z != 1.0:
                    if z <= 0.0:
                        continue
                    x, y = x / z, y / z
                if not (-MARGIN <= x <= width - 1 + MARGIN and -MARGIN <= y <= height - 1 + MARGIN):
                    continue
                x0, y0 = min(max(int(x), 0), width - 1), min(max(int(y), 0), height - 1)
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                right, down = np.float32(x - x0), np.float32(y - y0)
                total = np.float32(0.0)
                for c in range(channels):
                    value = view[y0, x0, c]
                    if right != 0.0:
                        value += right * (view[y0, x1, c] - value)
                    if down != 0.0:
                        lower = view[y1, x0, c]
                        if right != 0.0:
                            lower += right * (view[y1, x1, c] - lower)
                        value += down * (lower - value)
                    total += (value - target[m, n, c]) ** 2
                if np.isfinite(total):
                    tensor[m, n, k] += share * total
                    count[m, n, k] += 1


@kernel
def subtract_at_labels(plane, first_label, homographies, weight, tensor):
    """Subtract a plane's values from labels, from a first one on, of the pixels these would draw there."""
    height, width, labels = tensor.shape
    for i in range(plane.shape[0]):
        for j in range(plane.shape[1]):
            if plane[i, j] == 0.0:
                continue
            for k in range(first_label[i, j], labels):
                h = homographies[k]
                z = h[2, 0] * j + h[2, 1] * i + h[2, 2]
                if z <= 0.0:
                    continue
                n = np.int64(np.floor((h[0, 0] * j + h[0, 1] * i + h[0, 2]) / z + 0.5))
                m = np.int64(np.floor((h[1, 0] * j + h[1, 1] * i + h[1, 2]) / z + 0.5))
                if 0 <= n < width and 0 <= m < height:
                    tensor[m, n, k] -= weight * plane[i, j]


@kernel
def normalise_errors(tensor, count, num_views):
    """Turn sums over the views that see a pixel into shares of all views, the reference included."""
    height, width, labels = tensor.shape
    for m in range(height):
        for n in range(width):
            total, num_seen = 0.0, 0
            for k in range(labels):
                seen = np.float32(count[m, n, k])
                if seen > 0:
                    tensor[m, n, k] *= np.float32(num_views) / (seen * np.float32(num_views + 1))
                    total += tensor[m, n, k]
                    num_seen += 1
            blind = np.float32(total / num_seen) if num_seen > 0 else np.float32(0.0)
            for k in range(labels):
                if count[m, n, k] == 0:
                    tensor[m, n, k] = blind


@kernel
def distance_transform(values, slope, transformed):
    """Lower envelope of cones with a slope at all values, in two passes; in place, if wanted."""
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
def add_child_l(values, prediction, cost, merge, candidates, transformed, loose, full):
    """Add to `full` what the best coefficient of a child costs, for each label of its parent."""
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
def shifted_sum(values, prediction, flat):
    """Add the values of a child at the labels that its parent predicts."""
    labels = values.shape[0]
    if prediction == 0:
        for d in range(labels):
            flat[d] += values[d]
        return
    for d in range(labels):
        shifted = d + prediction
        flat[d] = flat[d] + values[shifted] if 0 <= shifted < labels else INF


@kernel
def join(full, flat, flags, values):
    """Choose between no coefficients below a node and some; return what was subtracted from both."""
    least = INF
    for d in range(full.shape[0]):
        values[d] = min(flat[d] + flags[0], full[d] + flags[1])
        least = min(least, values[d])
    for d in range(full.shape[0]):
        values[d] -= least
        flat[d] -= least
    return least


@kernel
def pass_up_l(errors, level, up, flat_up):
    """One level of the bottom-up pass (3.28); return what was subtracted from all nodes."""
    values, flat = errors
    predictions, kinds, costs, node_kinds, flags, merge, candidates = level
    height, width, labels = values.shape
    transformed, loose = np.empty(labels, np.float32), np.empty(labels, np.float32)
    full = np.empty(labels, np.float32)
    total = 0.0
    for m in range(up.shape[0]):
        for n in range(up.shape[1]):
            full[:] = 0.0
            below = flat_up[m, n]
            below[:] = 0.0
            splits = flags[node_kinds[m, n], 1] < INF
            for i in range(2 * m, min(2 * m + 2, height)):
                for j in range(2 * n, min(2 * n + 2, width)):
                    if splits:
                        add_child_l(
                            values[i, j],
                            predictions[i, j],
                            costs[kinds[i, j]],
                            merge[kinds[i, j]],
                            candidates[i, j],
                            transformed,
                            loose,
                            full,
                        )
                    shifted_sum(flat[i, j], predictions[i, j], below)
            total += join(full, below, flags[node_kinds[m, n]], up[m, n])
    return total


@kernel
def step_cost(cost, magnitude):
    """Cost of a coefficient that is not as predicted, but for labels of neighbours."""
    step = np.float32(magnitude)
    return min(cost[NONZERO] + cost[SLOPE] * step, cost[JUMP]) + cost[TEAR] * step


@kernel
def best_child_l(values, predicted, cost, merge, candidates):
    """Label of a child that its parent chooses, given what it predicts, and what it costs."""
    labels = values.shape[0]
    best, label = INF, 0
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
def pass_down_l(errors, level, nodes, children):
    """One level of back-tracking: labels of children, and which of them may have coefficients below."""
    values, flat = errors
    predictions, kinds, costs, node_kinds, flags, merge, candidates = level
    (parents, alive), (labels, live) = nodes, children
    height, width, _ = values.shape
    chosen = np.zeros((2, 2), np.int64)
    for m in range(parents.shape[0]):
        for n in range(parents.shape[1]):
            flag = flags[node_kinds[m, n]]
            splits = False
            if alive[m, n] and flag[1] < INF:
                full, below = flag[1], flag[0]
                for i in range(2 * m, min(2 * m + 2, height)):
                    for j in range(2 * n, min(2 * n + 2, width)):
                        predicted = parents[m, n] + predictions[i, j]
                        kind = kinds[i, j]
                        label, cost = best_child_l(
                            values[i, j], predicted, costs[kind], merge[kind], candidates[i, j]
                        )
                        chosen[i - 2 * m, j - 2 * n] = label
                        full += cost
                        inside = 0 <= predicted < values.shape[2]
                        below += flat[i, j, predicted] if inside else INF
                splits = full < below
            for i in range(2 * m, min(2 * m + 2, height)):
                for j in range(2 * n, min(2 * n + 2, width)):
                    predicted = parents[m, n] + predictions[i, j]
                    labels[i, j] = chosen[i - 2 * m, j - 2 * n] if splits else predicted
                    live[i, j] = splits


# ---- dynamic programming: S ----


@kernel
def combine_s(first, second, prediction, cost, floor, low):
    """Low-pass errors of two samples (3.29): for each mean the best difference, those near first."""
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
    """Difference of two samples whose mean is known, and what it costs."""
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
def columns_s(values, predictions, kinds, costs, m, n, columns):
    """Low-pass errors of the columns below a node; return how many there are."""
    height, width, _labels = values.shape
    count = min(2, width - 2 * n)
    for c in range(count):
        i, j = 2 * m, 2 * n + c
        if i + 1 < height:
            combine_s(
                values[i, j], values[i + 1, j], predictions[i + 1, j], costs[kinds[i + 1, j]], 0.0, columns[c]
            )
        else:
            columns[c, :] = values[i, j]
    return count


@kernel
def flat_s(flat, predictions, m, n, low, total):
    """Errors of all labels of a node whose coefficients are as predicted, from `low` on."""
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
def pass_up_s(errors, level, up, flat_up):
    """One level of the bottom-up pass (3.29), vertically, then horizontally."""
    values, flat = errors
    predictions, kinds, costs, node_kinds, flags, _, _ = level
    labels = values.shape[2]
    columns, full = np.empty((2, labels), np.float32), np.empty(labels, np.float32)
    total = 0.0
    for m in range(up.shape[0]):
        for n in range(up.shape[1]):
            flat_s(flat, predictions, m, n, 0, flat_up[m, n])
            if not flags[node_kinds[m, n], 1] < INF:
                full[:] = INF
            elif columns_s(values, predictions, kinds, costs, m, n, columns) == 2:
                cost = costs[kinds[2 * m, 2 * n + 1]]
                floor = columns[0].min() + columns[1].min()
                combine_s(columns[0], columns[1], predictions[2 * m, 2 * n + 1], cost, floor, full)
            else:
                full[:] = columns[0]
            total += join(full, flat_up[m, n], flags[node_kinds[m, n]], up[m, n])
    return total


@kernel
def pass_down_s(errors, level, nodes, highs, children):
    """One level of back-tracking: coefficients, and labels of the children."""
    values, flat = errors
    predictions, kinds, costs, node_kinds, flags, _, _ = level
    (parents, alive), (labels, live) = nodes, children
    height, width, num_labels = values.shape
    columns, below = np.empty((2, num_labels), np.float32), np.empty(1, np.float32)
    for m in range(parents.shape[0]):
        for n in range(parents.shape[1]):
            flag, low = flags[node_kinds[m, n]], parents[m, n]
            splits, horizontal = False, np.int64(0)
            if 2 * n + 1 < width:
                horizontal = np.int64(predictions[2 * m, 2 * n + 1])
            if alive[m, n] and flag[1] < INF:
                flat_s(flat, predictions, m, n, low, below)
                if columns_s(values, predictions, kinds, costs, m, n, columns) == 2:
                    cost = costs[kinds[2 * m, 2 * n + 1]]
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
                        high, _ = best_s(values[i, j], values[i + 1, j], column, high, costs[kinds[i + 1, j]])
                    highs[i + 1, j] = high
                    labels[i, j], labels[i + 1, j] = column - (high >> 1) + high, column - (high >> 1)
                    live[i + 1, j] = splits


# ---- coding ----

NUM_LEVELS = 6  # that contexts tell apart; coarser ones share the last
NUM_CLASSES = 2  # of significance
NUM_PLACES = 5  # what neighbours of a sample say: 0: as predicted; then one or more differ a little or much
LITTLE = 2  # labels
NUM_DISTANCES = 5  # of a candidate from the prediction: 1, 2 to 3, 4 to 7, ...
NUM_COEFFICIENT_KINDS = NUM_CLASSES * NUM_PLACES
NUM_NODE_KINDS = 1 + 3 * NUM_CLASSES * NUM_PLACES  # the first has nothing below
NUM_EXPONENTS = 13

# Contexts: those of all levels, then those by level.
FLAGS = 0
ZEROS = FLAGS + (1 + NUM_LEVELS) * NUM_NODE_KINDS
MERGES = ZEROS + (1 + NUM_LEVELS) * NUM_COEFFICIENT_KINDS * 3
DISTANCES = MERGES + (1 + NUM_LEVELS) * NUM_CANDIDATES * NUM_PLACES
SIGNS = DISTANCES + NUM_CANDIDATES * NUM_DISTANCES
EXPONENTS = SIGNS + 3
MANTISSAS = EXPONENTS + (1 + NUM_LEVELS) * NUM_EXPONENTS
NUM_CONTEXTS = MANTISSAS + NUM_EXPONENTS
MAX_SYMBOLS = 1 + 4 * (2 + NUM_CANDIDATES + 2 * NUM_EXPONENTS)  # of a node

# Mixtures.
MIX_FLAG, MIX_ZERO, MIX_MERGE, MIX_EXPONENT, MIX_SINGLE = range(5)
NUM_MIXTURES = 5

# What is counted while coding, by level and kind of coefficient.
SAME, OTHER, MERGED, UNMERGED, RESTS, MAGNITUDES = 0, 1, 2, 4, 6, 7
NUM_STATISTICS = 8


@kernel
def code_single(coder, model, context, decision):
    """Code a decision in one context, and return it."""
    decision = code_decision(coder, min(max(model.contexts[context, 0], 2.0**-12), 1.0 - 2.0**-12), decision)
    learn(model, context, decision)
    return decision


class Model(NamedTuple):
    """Adaptive model of a tree's code."""

    mixture: Mixture
    level: int  # that contexts know


class Level(NamedTuple):
    """What is known of a level of a tree before it is coded."""

    parents: NDArray[np.int32]  # labels of the nodes
    alive: NDArray[np.uint8]  # nodes that may have coefficients below
    significance: NDArray[np.uint8]  # classes of the nodes
    is_open: NDArray[np.bool_]  # nodes below which anything is significant
    predictions: NDArray[np.int32]  # of coefficients
    num_labels: int


class Coded(NamedTuple):
    """What is written of a level, or read into these arrays."""

    splits: NDArray[np.uint8]  # nodes with coefficients below that are not as predicted
    highs: NDArray[np.int32]  # coefficients
    labels: NDArray[np.int32]  # of the children
    live: NDArray[np.uint8]  # children of nodes that are split


class Seen(NamedTuple):
    """How often what was coded."""

    flags: NDArray[np.int64]
    coefficients: NDArray[np.int64]


@kernel
def new_around():
    """Return work space for what neighbours say."""
    return Around(np.zeros(2, np.int64), np.zeros(1, np.int64), np.zeros(NUM_CANDIDATES, np.int64))


@kernel
def forget(around):
    """Forget all neighbours."""
    around.counts[:] = 0
    around.lean[0] = 0
    around.candidates[:] = NONE


@kernel
def note(value, predicted, around):
    """Take a neighbour into account: whether it differs a little or much, where to, and its label."""
    difference = np.int64(value) - predicted
    if difference == 0:
        return
    around.counts[0 if abs(difference) <= LITTLE else 1] += 1
    around.lean[0] += 1 if difference > 0 else -1
    candidates = around.candidates
    for c in range(NUM_CANDIDATES):
        if candidates[c] == value:
            return
        if candidates[c] == NONE:
            candidates[c] = value
            return


@kernel
def summary(around):
    """Number, from `NUM_PLACES`, of how many neighbours differ how much."""
    if around.counts[1] > 0:
        return 3 if around.counts[1] == 1 else 4
    return min(around.counts[0], 2)


@kernel
def look_around_l(labels, parents, i, j, predicted, around):
    """Look at the neighbours of a sample that are known before it; return the number of its surroundings."""
    forget(around)
    if j > 0:
        note(labels[i, j - 1], predicted, around)
    if i > 0:
        note(labels[i - 1, j], predicted, around)
    if j % 2 == 1 and j // 2 + 1 < parents.shape[1]:
        note(parents[i // 2, j // 2 + 1], predicted, around)
    if i % 2 == 1 and i // 2 + 1 < parents.shape[0]:
        note(parents[i // 2 + 1, j // 2], predicted, around)
    return summary(around)


@kernel
def look_around_s(labels, parents, i, j, mean, around):
    """Look at what lies on both sides of two samples that are about to be separated."""
    forget(around)
    m, n = i // 2, j // 2
    if i % 2 == 1:  # a vertical difference
        if m > 0:
            note(labels[2 * m - 1, j], mean, around)
        before = around.lean[0]
        if m + 1 < parents.shape[0]:
            note(parents[m + 1, n], mean, around)
    else:
        if n > 0:
            note(labels[i, 2 * n - 1], mean, around)
        before = around.lean[0]
        if n + 1 < parents.shape[1]:
            note(parents[m, n + 1], mean, around)
    around.lean[0] = 2 * before - around.lean[0]
    around.candidates[:] = NONE
    return summary(around)


@kernel
def kind_of_node(m, n, parents, splits, significance, is_open, around):
    """Kind of a node, by its neighbours and what was found below those before it."""
    if not is_open[m, n]:
        return 0
    forget(around)
    before = 0
    if n > 0:
        note(parents[m, n - 1], parents[m, n], around)
        before += splits[m, n - 1]
    if m > 0:
        note(parents[m - 1, n], parents[m, n], around)
        before += splits[m - 1, n]
    if n + 1 < parents.shape[1]:
        note(parents[m, n + 1], parents[m, n], around)
    if m + 1 < parents.shape[0]:
        note(parents[m + 1, n], parents[m, n], around)
    return 1 + (significance[m, n] * NUM_PLACES + summary(around)) * 3 + before


@kernel
def code_rest(coder, model, level, sign, value):
    """Code a number that is not 0: its sign, and its magnitude by an adaptive code of Exp-Golomb."""
    positive = code_single(coder, model, SIGNS + sign, int(value > 0))
    magnitude = abs(value)  # at least 1
    exponent = 0
    while code_mixed(
        coder,
        model,
        EXPONENTS + exponent,
        EXPONENTS + (1 + level) * NUM_EXPONENTS + exponent,
        -1,
        MIX_EXPONENT,
        int(magnitude >> (exponent + 1) > 0),
    ):
        exponent += 1
        if exponent >= NUM_EXPONENTS:
            coder.fields[FAILED] = 1
            return 1
    coded = 1
    for k in range(exponent - 1, -1, -1):
        digit = magnitude >> k & 1
        if k == exponent - 1:
            coded = coded << 1 | code_single(coder, model, MANTISSAS + exponent, digit)
        else:
            coded = coded << 1 | code_decision(coder, 0.5, digit)
    return coded if positive else -coded


@kernel
def code_flag(coder, model, level, kind, split):
    """Code whether there is anything below a node, and return it."""
    first = FLAGS + kind
    return code_mixed(coder, model, first, first + (1 + level) * NUM_NODE_KINDS, -1, MIX_FLAG, split)


@kernel
def distance_class(difference):
    """Class of how far a candidate is, from `NUM_DISTANCES`."""
    magnitude, found = abs(difference), 0
    while magnitude > 1 and found < NUM_DISTANCES - 1:
        magnitude >>= 1
        found += 1
    return found


@kernel
def code_coefficient(coder, model, kind, before, predicted, value, around, statistics):
    """Code a label or coefficient by how it differs from what is predicted, and return it."""
    mixture, level = model
    candidates = around.candidates
    first = ZEROS + kind * 3 + before
    second = first + (1 + level) * NUM_COEFFICIENT_KINDS * 3
    seen = statistics[kind]
    if not code_mixed(coder, mixture, first, second, -1, MIX_ZERO, int(value != predicted)):
        seen[SAME] += 1
        return predicted
    seen[OTHER] += 1
    for c in range(NUM_CANDIDATES):
        if candidates[c] != NONE:
            first = DISTANCES + c * NUM_DISTANCES + distance_class(candidates[c] - predicted)
            second = MERGES + ((1 + level) * NUM_CANDIDATES + c) * NUM_PLACES + kind % NUM_PLACES
            merged = code_mixed(coder, mixture, first, second, -1, MIX_MERGE, int(value == candidates[c]))
            seen[(MERGED if merged else UNMERGED) + c] += 1
            if merged:
                return candidates[c]
    sign = 1 + (around.lean[0] > 0) - (around.lean[0] < 0)
    difference = code_rest(coder, mixture, level, sign, value - predicted)
    seen[RESTS] += 1
    seen[MAGNITUDES] += abs(difference) - 1
    return predicted + difference


@kernel
def code_split(coder, model, m, n, known, coded, flags, around):
    """Code whether there is anything below a node."""
    splits, split = coded.splits, 0
    if known.alive[m, n]:
        kind = kind_of_node(m, n, known.parents, splits, known.significance, known.is_open, around)
        if kind > 0:
            split = code_flag(coder, model.mixture, model.level, kind, int(splits[m, n]))
            flags[kind, split] += 1
    splits[m, n] = split
    return split


@kernel
def code_row_l(coder, model, m, known, coded, seen):
    """Code what is below a row of nodes: whether there is anything, and the labels of their children."""
    parents, _, significance, _, predictions, num_labels = known
    labels, live = coded.labels, coded.live
    height, width = labels.shape
    around = new_around()
    for n in range(parents.shape[1]):
        split = code_split(coder, model, m, n, known, coded, seen.flags, around)
        before = 0
        for i in range(2 * m, min(2 * m + 2, height)):
            for j in range(2 * n, min(2 * n + 2, width)):
                predicted = np.int64(parents[m, n]) + predictions[i, j]
                label = predicted
                if split and significance[m, n]:
                    where = look_around_l(labels, parents, i, j, predicted, around)
                    kind, value = significance[m, n] * NUM_PLACES + where, np.int64(labels[i, j])
                    label = code_coefficient(
                        coder, model, kind, before, predicted, value, around, seen.coefficients
                    )
                    before = 2 if label != predicted else max(before, 1)
                labels[i, j] = min(max(label, 0), num_labels - 1)
                live[i, j] = split


class Difference(NamedTuple):
    """Where a difference of two samples is, and what is known of it."""

    i: int
    j: int
    mean: int  # of the samples
    predicted: int
    before: int  # whether differences below the same node were as predicted


@kernel
def code_difference_s(coder, model, known, coded, seen, difference, around):
    """Code a difference of two samples with a mean."""
    i, j, mean, predicted, before = difference
    where = look_around_s(coded.labels, known.parents, i, j, mean, around)
    kind = known.significance[i // 2, j // 2] * NUM_PLACES + where
    value = np.int64(coded.highs[i, j])
    return code_coefficient(coder, model, kind, before, predicted, value, around, seen.coefficients)


@kernel
def code_row_s(coder, model, m, known, coded, seen):
    """Code what is below a row of nodes: whether there is anything, and the differences of their children."""
    parents, predictions, num_labels = known.parents, known.predictions, known.num_labels
    _, highs, labels, live = coded
    height, width = labels.shape
    around = new_around()
    for n in range(parents.shape[1]):
        split = code_split(coder, model, m, n, known, coded, seen.flags, around)
        is_coded = split and known.significance[m, n]
        before, horizontal = 0, np.int64(0)
        mean = np.int64(parents[m, n])
        if 2 * n + 1 < width:
            i, j = 2 * m, 2 * n + 1
            horizontal = np.int64(predictions[i, j])
            if is_coded:
                where = Difference(i, j, mean, horizontal, before)
                value = code_difference_s(coder, model, known, coded, seen, where, around)
                before = 2 if value != horizontal else 1
                horizontal = value
            horizontal = min(max(horizontal, -num_labels), num_labels)
            highs[i, j] = horizontal
        for c in range(min(2, width - 2 * n)):
            i, j = 2 * m, 2 * n + c
            column = mean
            if 2 * n + 1 < width:
                column = mean - (horizontal >> 1) + (horizontal if c == 0 else 0)
            labels[i, j], live[i, j] = min(max(column, 0), num_labels - 1), split
            if i + 1 < height:
                vertical = np.int64(predictions[i + 1, j])
                if is_coded:
                    where = Difference(i + 1, j, column, vertical, before)
                    value = code_difference_s(coder, model, known, coded, seen, where, around)
                    before = 2 if value != vertical else max(before, 1)
                    vertical = value
                vertical = min(max(vertical, -num_labels), num_labels)
                highs[i + 1, j] = vertical
                labels[i, j] = min(max(column - (vertical >> 1) + vertical, 0), num_labels - 1)
                labels[i + 1, j] = min(max(column - (vertical >> 1), 0), num_labels - 1)
                live[i + 1, j] = split


@kernel
def kinds_l(parents, labels, predictions, significance, kinds, candidates):
    """Kinds of the coefficients of a solution, and labels of their neighbours."""
    around = new_around()
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            predicted = np.int64(parents[i // 2, j // 2]) + predictions[i, j]
            where = look_around_l(labels, parents, i, j, predicted, around)
            candidates[i, j] = around.candidates
            kinds[i, j] = significance[i // 2, j // 2] * NUM_PLACES + where


@kernel
def kinds_s(parents, labels, significance, kinds):
    """Kinds of the coefficients of a solution."""
    around = new_around()
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            mean = np.int64(parents[i // 2, j // 2])
            if i % 2 == 1:
                mean = (np.int64(labels[i - 1, j]) + labels[i, j]) >> 1
            where = look_around_s(labels, parents, i, j, mean, around)
            kinds[i, j] = significance[i // 2, j // 2] * NUM_PLACES + where


@kernel
def kinds_of_nodes(parents, splits, significance, is_open, kinds):
    """Kinds of the nodes of a solution."""
    around = new_around()
    for m in range(kinds.shape[0]):
        for n in range(kinds.shape[1]):
            kinds[m, n] = kind_of_node(m, n, parents, splits, significance, is_open, around)


@kernel
def code_differences(coder, counts, values, predictions):
    """Code a plane as differences."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            difference = np.int64(values[i, j]) - predictions[i, j]
            values[i, j] = predictions[i, j] + code_exp_golomb(
                coder, counts, 0, 1, 2, 2 + BINARY_EXPONENTS, difference
            )


class Alphabet(NamedTuple):
    """Labels of a quadtree, and where their contexts begin."""

    first: int
    num_digits: int
    num_labels: int


@kernel
def code_squares(coder, counts, level, alphabet, alive, split, given, labels):
    """Code for a row of squares of a quadtree which are split, and the labels of those that are not."""
    first, num_digits, num_labels = alphabet
    for n in range(alive.shape[0]):
        if not alive[n]:
            split[n] = False
            continue
        if level > 0:
            split[n] = code_adaptive(coder, counts, level, int(split[n])) > 0
        if not split[n]:
            prefix = 1
            for k in range(num_digits - 1, -1, -1):
                prefix = prefix << 1 | code_adaptive(coder, counts, first + prefix, given[n] >> k & 1)
            labels[n] = min(prefix - (1 << num_digits), num_labels - 1)
