"""Compiled loops that code disparity trees and quadtrees; described by their callers.

Each function codes in both directions: it writes given values, or reads them. Labels and coefficients are
int32.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.binarisation import NUM_EXPONENTS as BINARY_EXPONENTS
from dvc.entropy.binarisation import code_exp_golomb
from dvc.entropy.mixing import code_adaptive, code_mixed, learn
from dvc.entropy.range_coder import FAILED, code_decision

NUM_CANDIDATES = 2
_ZERO, _ONE, _TWO = np.arange(3)  # no literals, for each of which numba compiles
_NO_CONTEXT = np.int64(-1)
NONE = -1  # label of a candidate that does not exist


# Neighbours of a sample or node: numbers of small and large differences from the prediction, sign of most
# differences, labels of neighbours.
SMALL, LARGE, LEAN, CANDIDATES = np.arange(4)
NUM_LEVELS = 6  # levels with contexts of their own; coarser ones share the last
NUM_CLASSES = 2  # classes of significance
NUM_SURROUNDINGS = 5  # neighbours of a sample: 0: all as predicted; then one or more differ a little or much
LITTLE = 2  # largest small difference, in labels
NUM_DISTANCES = 5  # distances of a candidate from the prediction: 1, 2 to 3, 4 to 7, ...
NUM_COEFFICIENT_KINDS = NUM_CLASSES * NUM_SURROUNDINGS
NUM_NODE_KINDS = 1 + 3 * NUM_CLASSES * NUM_SURROUNDINGS  # the first has nothing below
NUM_EXPONENTS = 13

# Contexts: those of all levels, then those by level.
FLAGS = 0
ZEROS = FLAGS + (1 + NUM_LEVELS) * NUM_NODE_KINDS
MERGES = ZEROS + (1 + NUM_LEVELS) * NUM_COEFFICIENT_KINDS * 3
DISTANCES = MERGES + (1 + NUM_LEVELS) * NUM_CANDIDATES * NUM_SURROUNDINGS
SIGNS = DISTANCES + NUM_CANDIDATES * NUM_DISTANCES
EXPONENTS = SIGNS + 3
MANTISSAS = EXPONENTS + (1 + NUM_LEVELS) * NUM_EXPONENTS
NUM_CONTEXTS = MANTISSAS + NUM_EXPONENTS
MAX_SYMBOLS = 1 + 4 * (2 + NUM_CANDIDATES + 2 * NUM_EXPONENTS)  # decisions of a node

# Mixtures.
MIX_FLAG, MIX_ZERO, MIX_MERGE, MIX_EXPONENT, MIX_SINGLE = np.arange(5)
NUM_MIXTURES = 5

# Columns of statistics, by level and kind of coefficient.
SAME, OTHER, MERGED, UNMERGED, RESTS, MAGNITUDES = 0, 1, 2, 4, 6, 7
NUM_STATISTICS = 8


@kernel
def code_single(coder, model, context, decision):
    """Code a decision in one context, and return it."""
    decision = code_decision(coder, min(max(model.contexts[context, 0], 2.0**-12), 1.0 - 2.0**-12), decision)
    learn(model, context, decision)
    return decision


class Level(NamedTuple):
    """State of a level of a tree before it is coded."""

    parents: NDArray[np.int32]  # labels of the nodes
    alive: NDArray[np.uint8]  # nodes that may have coefficients below
    significance: NDArray[np.uint8]  # classes of the nodes
    is_open: NDArray[np.bool_]  # nodes below which anything is significant
    predictions: NDArray[np.int32]  # predicted coefficients
    num_labels: int


class Coded(NamedTuple):
    """Values of a level to be written, or arrays to read them into."""

    splits: NDArray[np.uint8]  # nodes with coefficients below that are not as predicted
    highs: NDArray[np.int32]  # coefficients
    labels: NDArray[np.int32]  # labels of the children
    live: NDArray[np.uint8]  # children of nodes that are split


@kernel
def clear(around):
    """Clear the work space for neighbours."""
    around[:CANDIDATES] = 0
    around[CANDIDATES:] = NONE


@kernel
def note(value, predicted, around):
    """Add a neighbour: whether it differs a little or much, to which side, and its label."""
    difference = np.int64(value) - predicted
    if difference == 0:
        return
    around[SMALL if abs(difference) <= LITTLE else LARGE] += 1
    around[LEAN] += 1 if difference > 0 else -1
    candidates = around[CANDIDATES:]
    for c in range(NUM_CANDIDATES):
        if candidates[c] == value:
            return
        if candidates[c] == NONE:
            candidates[c] = value
            return


@kernel
def summary(around):
    """Return the class of the neighbours, below `NUM_SURROUNDINGS`."""
    if around[LARGE] > 0:
        return 3 if around[LARGE] == 1 else 4
    return min(around[SMALL], 2)


@kernel
def look_around_l(labels, parents, i, j, predicted, around):
    """Add the neighbours of a sample that precede it; return the class of its surroundings."""
    clear(around)
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
    """Add the neighbours on both sides of two samples that are about to be separated; return their class."""
    clear(around)
    m, n = i // 2, j // 2
    if i % 2 == 1:  # a vertical difference
        if m > 0:
            note(labels[2 * m - 1, j], mean, around)
        before = around[LEAN]
        if m + 1 < parents.shape[0]:
            note(parents[m + 1, n], mean, around)
    else:
        if n > 0:
            note(labels[i, 2 * n - 1], mean, around)
        before = around[LEAN]
        if n + 1 < parents.shape[1]:
            note(parents[m, n + 1], mean, around)
    around[LEAN] = 2 * before - around[LEAN]
    around[CANDIDATES:] = NONE
    return summary(around)


@kernel
def kind_of_node(m, n, parents, splits, significance, is_open, around):
    """Return the kind of a node, by its neighbours and whether those before it have coefficients below."""
    if not is_open[m, n]:
        return 0
    clear(around)
    before, predicted = 0, np.int64(parents[m, n])
    if n > 0:
        note(parents[m, n - 1], predicted, around)
        before += splits[m, n - 1]
    if m > 0:
        note(parents[m - 1, n], predicted, around)
        before += splits[m - 1, n]
    if n + 1 < parents.shape[1]:
        note(parents[m, n + 1], predicted, around)
    if m + 1 < parents.shape[0]:
        note(parents[m + 1, n], predicted, around)
    return 1 + (significance[m, n] * NUM_SURROUNDINGS + summary(around)) * 3 + before


@kernel
def code_rest(coder, model, level, sign, value):
    """Code a number other than 0: its sign, and its magnitude by an adaptive Exp-Golomb code."""
    positive = code_single(coder, model, SIGNS + sign, int(value > 0))
    magnitude = abs(value)  # at least 1
    exponent = 0
    while True:
        context = EXPONENTS + (1 + level) * NUM_EXPONENTS + exponent
        more = int(magnitude >> (exponent + 1) > 0)
        if not code_mixed(coder, model, EXPONENTS + exponent, context, _NO_CONTEXT, MIX_EXPONENT, more):
            break
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
def code_coefficient(coder, mixture, level, kind, before, predicted, value, around, statistics):
    """Code a label or coefficient by its difference from its prediction, and return it."""
    candidates = around[CANDIDATES:]
    first = ZEROS + kind * 3 + before
    second = first + (1 + level) * NUM_COEFFICIENT_KINDS * 3
    seen = statistics[kind]
    if not code_mixed(coder, mixture, first, second, _NO_CONTEXT, MIX_ZERO, int(value != predicted)):
        seen[SAME] += 1
        return predicted
    seen[OTHER] += 1
    for c in range(NUM_CANDIDATES):
        if candidates[c] != NONE:
            distance, first = abs(candidates[c] - predicted), DISTANCES + c * NUM_DISTANCES
            while distance > 1 and first < DISTANCES + (c + 1) * NUM_DISTANCES - 1:
                distance >>= 1
                first += 1
            second = MERGES + ((1 + level) * NUM_CANDIDATES + c) * NUM_SURROUNDINGS + kind % NUM_SURROUNDINGS
            merged = code_mixed(
                coder, mixture, first, second, _NO_CONTEXT, MIX_MERGE, int(value == candidates[c])
            )
            seen[(MERGED if merged else UNMERGED) + c] += 1
            if merged:
                return candidates[c]
    sign = 1 + (around[LEAN] > 0) - (around[LEAN] < 0)
    difference = code_rest(coder, mixture, level, sign, value - predicted)
    seen[RESTS] += 1
    seen[MAGNITUDES] += abs(difference) - 1
    return predicted + difference


@kernel
def code_split(coder, mixture, level, m, n, known, coded, flags, around):
    """Code whether a node has coefficients below."""
    splits, split = coded.splits, 0
    if known.alive[m, n]:
        kind = kind_of_node(m, n, known.parents, splits, known.significance, known.is_open, around)
        if kind > 0:
            first, split = FLAGS + kind, np.int64(splits[m, n])
            second = first + (1 + level) * NUM_NODE_KINDS
            split = code_mixed(coder, mixture, first, second, _NO_CONTEXT, MIX_FLAG, split)
            flags[kind, split] += 1
    splits[m, n] = split
    return split


@kernel
def code_row_l(coder, mixture, level, m, known, coded, flags, coefficients):
    """Code the children of a row of nodes: whether a node is split, and the labels of its children."""
    parents, _, significance, _, predictions, num_labels = known
    labels, live = coded.labels, coded.live
    height, width = labels.shape
    around = np.empty(CANDIDATES + NUM_CANDIDATES, np.int64)
    for n in range(parents.shape[1]):
        split = code_split(coder, mixture, level, m, n, known, coded, flags, around)
        before = _ZERO
        for i in range(2 * m, min(2 * m + 2, height)):
            for j in range(2 * n, min(2 * n + 2, width)):
                label = predicted = np.int64(parents[m, n]) + predictions[i, j]
                if split and significance[m, n]:
                    surroundings = look_around_l(labels, parents, i, j, predicted, around)
                    kind, value = significance[m, n] * NUM_SURROUNDINGS + surroundings, np.int64(labels[i, j])
                    label = code_coefficient(
                        coder, mixture, level, kind, before, predicted, value, around, coefficients
                    )
                    before = 2 if label != predicted else max(before, 1)
                labels[i, j] = min(max(label, 0), num_labels - 1)
                live[i, j] = split


@kernel
def code_difference_s(coder, mixture, level, i, j, mean, predicted, before, known, coded, statistics, around):
    """Code a difference of two samples with a mean."""
    surroundings = look_around_s(coded.labels, known.parents, i, j, mean, around)
    kind = known.significance[i // 2, j // 2] * NUM_SURROUNDINGS + surroundings
    value = np.int64(coded.highs[i, j])
    return code_coefficient(coder, mixture, level, kind, before, predicted, value, around, statistics)


@kernel
def code_row_s(coder, mixture, level, m, known, coded, flags, counts):
    """Code the children of a row of nodes: whether a node is split, and the differences of its children."""
    parents, predictions, num_labels = known.parents, known.predictions, known.num_labels
    _, highs, labels, live = coded
    height, width = labels.shape
    around = np.empty(CANDIDATES + NUM_CANDIDATES, np.int64)
    for n in range(parents.shape[1]):
        split = code_split(coder, mixture, level, m, n, known, coded, flags, around)
        is_coded = split and known.significance[m, n]
        before, horizontal = _ZERO, np.int64(0)
        mean = np.int64(parents[m, n])
        if 2 * n + 1 < width:
            i, j = 2 * m, 2 * n + 1
            horizontal = predicted = np.int64(predictions[i, j])
            if is_coded:
                horizontal = code_difference_s(
                    coder, mixture, level, i, j, mean, predicted, before, known, coded, counts, around
                )
                before = 2 if horizontal != predicted else 1
            horizontal = min(max(horizontal, -num_labels), num_labels)
            highs[i, j] = horizontal
        for c in range(min(2, width - 2 * n)):
            i, j = 2 * m, 2 * n + c
            column = mean
            if 2 * n + 1 < width:
                column = mean - (horizontal >> 1) + (horizontal if c == 0 else 0)
            labels[i, j], live[i, j] = min(max(column, 0), num_labels - 1), split
            if i + 1 < height:
                i += 1
                vertical = predicted = np.int64(predictions[i, j])
                if is_coded:
                    vertical = code_difference_s(
                        coder, mixture, level, i, j, column, predicted, before, known, coded, counts, around
                    )
                    before = 2 if vertical != predicted else max(before, 1)
                vertical = min(max(vertical, -num_labels), num_labels)
                highs[i, j] = vertical
                labels[i - 1, j] = min(max(column - (vertical >> 1) + vertical, 0), num_labels - 1)
                labels[i, j] = min(max(column - (vertical >> 1), 0), num_labels - 1)
                live[i, j] = split


@kernel
def set_kinds(is_s, parents, labels, predictions, significance, splits, is_open, kinds, nodes, candidates):
    """Set the kinds of the coefficients and nodes of a solution, and labels of neighbours (L only)."""
    around = np.empty(CANDIDATES + NUM_CANDIDATES, np.int64)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            expected = np.int64(parents[i // 2, j // 2])
            if not is_s:
                expected += predictions[i, j]
                surroundings = look_around_l(labels, parents, i, j, expected, around)
                for c in range(NUM_CANDIDATES):
                    candidates[i, j, c] = around[CANDIDATES + c]
            else:
                if i % 2 == 1:
                    expected = (np.int64(labels[i - 1, j]) + labels[i, j]) >> 1
                surroundings = look_around_s(labels, parents, i, j, expected, around)
            kinds[i, j] = significance[i // 2, j // 2] * NUM_SURROUNDINGS + surroundings
    for m in range(nodes.shape[0]):
        for n in range(nodes.shape[1]):
            nodes[m, n] = kind_of_node(m, n, parents, splits, significance, is_open, around)


@kernel
def code_differences(coder, counts, values, predictions):
    """Code a plane as differences."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            difference = np.int64(values[i, j]) - predictions[i, j]
            values[i, j] = predictions[i, j] + code_exp_golomb(
                coder, counts, _ZERO, _ONE, _TWO, _TWO + BINARY_EXPONENTS, difference
            )


@kernel
def code_squares(coder, counts, level, first, num_digits, num_labels, alive, split, given, labels):
    """Code for a row of squares of a quadtree which are split, and the labels of the leaves."""
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
