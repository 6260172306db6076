"""Compiled loops of the coder: passes over zerotrees, contexts, mixed probabilities.

Each function codes in both directions: it writes the decisions that the target values lead to, or reads them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.mixing import Mixture, learn_mixed, mixed_probability
from dvc.entropy.range_coder import POSITION, READING, CoderState, code_decision, is_settled

# Columns of `Run.nodes`. What follows EXISTS is what a writer knows: all zeros for a reader.
PARENT, CHILD, CHILD_ROWS, CHILD_COLUMNS, BAND, EXISTS, HAS_CHILDREN, HAS_GRANDCHILDREN = range(8)
LAST_PLANE, OPENED, TARGET, LARGEST_BELOW, LARGEST_DEEPER = range(8, 13)
NUM_COLUMNS = 13

# Columns of `Run.bands`.
STRIDE, KIND, LEVEL, COMPONENT = range(4)
LOW_BAND, HORIZONTAL, VERTICAL, DIAGONAL = range(4)

# Rows of `Run.lists`, and how long each is, in `Run.fields`.
PENDING, SETS, SIGNIFICANT, OPENING = range(4)
STOPPED, PLANE = 4, 5

# Where the contexts of a kind of decision begin in each of three tables, and its weights.
_COEFFICIENT = (0, 256, 512, 0)
_SET = (1024, 1280, 1536, 24)
_REFINEMENT = (1920, 1984, 2048, 56)
_SIGN = (2112, 2176, 2240, 60)
NUM_CONTEXTS, NUM_WEIGHTS = 2304, 64

FIRST_POINT, LATER_POINT = 1.4, 0.48
"""Where a magnitude lies from its threshold on, in thresholds, when it is found and once it is refined."""


class Run(NamedTuple):
    """What a coder works on: arrays only, few of them, as each access to one in a tuple costs time.

    Attributes
    ----------
    coder : CoderState
        Where to write or to read.
    fields : ndarray of shape (8,), int64
        Lengths of the lists, whether the data are used up, and the bit plane.
    values : ndarray of shape (S,), int32
        Coefficients as far as they are known, in steps, with their signs.
    nodes : ndarray of shape (S, 13), int32
        Trees and what is known of them.
    bands : ndarray of shape (B, 4), int32
        Bands of coefficients.
    lists : ndarray of shape (4, S), int32
        Coefficients not yet significant; sets, those of grandchildren negative; significant coefficients;
        nodes whose children are to be coded.
    exact : ndarray of shape (S,), float64
        Magnitudes before quantisation, in steps, of a writer.
    curve : ndarray of shape (W,), float64
        Squared error once each word is written, and last the one now.
    mixture : Mixture
        Of three contexts.
    num_bytes : int
        How many there are, or may be.
    adaptive : bool
        Whether decisions have contexts; else each takes a bit.
    """

    coder: CoderState
    fields: NDArray[np.int64]
    values: NDArray[np.int32]
    nodes: NDArray[np.int32]
    bands: NDArray[np.int32]
    lists: NDArray[np.int32]
    exact: NDArray[np.float64]
    curve: NDArray[np.float64]
    mixture: Mixture
    num_bytes: int
    adaptive: bool


@kernel
def gather_below(nodes, column, below, deeper):
    """Set two columns to the largest magnitude of another among descendants, and among those but children."""
    for i in range(len(nodes) - 1, 0, -1):
        parent = nodes[i, PARENT]
        if parent > 0:
            nodes[parent, below] = max(nodes[parent, below], abs(nodes[i, column]), nodes[i, below])
            nodes[parent, deeper] = max(nodes[parent, deeper], nodes[i, below])


@kernel
def code_planes(run, roots, num_planes, lowest_plane):
    """Code bit planes, the highest first, to a last one or until the data or the room are used up."""
    fields, lists, nodes = run.fields, run.lists, run.nodes
    for root in roots:
        if nodes[root, EXISTS]:
            _append(fields, lists, PENDING, root)
        if nodes[root, HAS_CHILDREN]:
            _append(fields, lists, SETS, root)
    for plane in range(num_planes - 1, lowest_plane - 1, -1):
        fields[PLANE] = plane
        num_refinable = fields[SIGNIFICANT]
        _pending_pass(run)
        _set_pass(run)
        for k in range(num_refinable):
            _refine(run, np.int64(lists[SIGNIFICANT, k]))
        if fields[STOPPED]:
            return


@kernel
def _append(fields, lists, which, entry):
    lists[which, fields[which]] = entry
    fields[which] += 1


@kernel
def _pending_pass(run):
    """Code which of the coefficients that are not yet significant are now."""
    fields, lists = run.fields, run.lists
    kept = 0
    for k in range(fields[PENDING]):
        i = np.int64(lists[PENDING, k])
        if fields[STOPPED] or not _code_coefficient(run, i, 0, False):
            lists[PENDING, kept] = i
            kept += 1
    fields[PENDING] = kept


@kernel
def _set_pass(run):
    """Code which sets hold a significant coefficient, and all that follows from it."""
    fields, lists = run.fields, run.lists
    count, kept = fields[SETS], 0
    for k in range(count):
        entry = np.int64(lists[SETS, k])
        deeper = entry < 0
        node = abs(entry)
        if not fields[STOPPED] and _code_set(run, node, deeper):
            if deeper:
                _split(run, node)
            else:
                _open(run, node)
            while fields[OPENING] and not fields[STOPPED]:
                fields[OPENING] -= 1
                _code_children(run, np.int64(lists[OPENING, fields[OPENING]]))
        else:
            lists[SETS, kept] = entry
            kept += 1
    for k in range(count, fields[SETS]):
        lists[SETS, kept] = lists[SETS, k]
        kept += 1
    fields[SETS] = kept


@kernel
def _open(run, node):
    run.nodes[node, OPENED] = 1
    _append(run.fields, run.lists, OPENING, node)


@kernel
def _child(run, node, k):
    """Return the k-th child of a node."""
    nodes = run.nodes
    first, columns = np.int64(nodes[node, CHILD]), np.int64(nodes[node, CHILD_COLUMNS])
    return first + k // columns * np.int64(run.bands[nodes[first, BAND], STRIDE]) + k % columns


@kernel
def _num_children(nodes, node):
    return np.int64(nodes[node, CHILD_ROWS]) * np.int64(nodes[node, CHILD_COLUMNS])


@kernel
def _code_children(run, node):
    """Code the children of a node one of whose descendants is significant; what follows takes no bits."""
    fields, nodes = run.fields, run.nodes
    number, left, found = _num_children(nodes, node), 0, False
    for k in range(number):
        left += nodes[_child(run, node, k), EXISTS]
    for k in range(number):
        child = _child(run, node, k)
        if nodes[child, EXISTS]:
            left -= 1
            certain = left == 0 and not found and not nodes[node, HAS_GRANDCHILDREN]
            if _code_coefficient(run, child, 1, certain):
                found = True
            else:
                _append(fields, run.lists, PENDING, child)
    if nodes[node, HAS_GRANDCHILDREN]:
        if not found or _code_set(run, node, True):
            _split(run, node)
        else:
            _append(fields, run.lists, SETS, -node)


@kernel
def _split(run, node):
    """Code which children have significant descendants, given that one of them has."""
    nodes = run.nodes
    number, left, found = _num_children(nodes, node), 0, False
    for k in range(number):
        left += nodes[_child(run, node, k), HAS_CHILDREN]
    for k in range(number):
        child = _child(run, node, k)
        if nodes[child, HAS_CHILDREN]:
            left -= 1
            if (left == 0 and not found) or _code_set(run, child, False):
                found = True
                _open(run, child)
            else:
                _append(run.fields, run.lists, SETS, child)


@kernel
def _level(value, plane):
    """Return the level of a magnitude: of 0, less, 1, 2, 4 ... half thresholds 0, 1, 2, 3, 5 ..."""
    steps = (value << 1) >> plane
    if steps == 0:
        return 1 if value > 0 else 0
    level = 2
    while steps > 3:
        level += 2
        steps >>= 1
    return level + min(steps - 1, 1)


@kernel
def _code_coefficient(run, i, mode, certain):
    """Code whether a coefficient is significant and, if so, its sign; 0 too once the data are used up."""
    fields, values, nodes = run.fields, run.values, run.nodes
    plane = fields[PLANE]
    target = np.int64(nodes[i, TARGET])
    if not certain:
        band = run.bands[nodes[i, BAND]]
        s, kind = np.int64(band[STRIDE]), np.int64(band[KIND])
        h = abs(np.int64(values[i - 1])) + abs(np.int64(values[i + 1]))
        v = abs(np.int64(values[i - s])) + abs(np.int64(values[i + s]))
        d = abs(np.int64(values[i - s - 1])) + abs(np.int64(values[i - s + 1]))
        d += abs(np.int64(values[i + s - 1])) + abs(np.int64(values[i + s + 1]))
        far = abs(np.int64(values[i - 2])) + abs(np.int64(values[i + 2]))
        far += abs(np.int64(values[i - 2 * s])) + abs(np.int64(values[i + 2 * s]))
        parent = abs(np.int64(values[nodes[i, PARENT]]))
        if kind == HORIZONTAL:
            h, v = v, h
        shape = 0 if kind == LOW_BAND else (2 if kind == DIAGONAL else 1)
        near = _level(2 * (h + v) + d, plane + 1)
        first = (shape * 4 + min(_level(h, plane), 6) // 2) * 4 + min(_level(v, plane), 6) // 2
        first = first * 4 + min(_level(d, plane), 6) // 2
        second = (min(near, 11) * 5 + min(_level(parent, plane), 8) // 2) * 2 + mode
        third = (min(np.int64(band[LEVEL]), 7) * 2 + min(np.int64(band[COMPONENT]), 1)) * 5
        third = (third + min(_level(far, plane), 8) // 2) * 6 + min(near, 10) // 2
        if not _decide(
            run, _COEFFICIENT, first, second, third, mode * 12 + min(near, 11), abs(target) >> plane > 0
        ):
            if not fields[STOPPED]:
                nodes[i, LAST_PLANE] = plane
            return False
    if fields[STOPPED]:
        return False
    sign = _code_sign(run, i, target < 0)
    if fields[STOPPED]:
        return False
    nodes[i, LAST_PLANE] = plane
    threshold = np.int64(1) << plane
    values[i] = sign * threshold
    _append(fields, run.lists, SIGNIFICANT, i)
    exact = run.exact[i]
    run.curve[-1] += (exact - FIRST_POINT * threshold) ** 2 - exact * exact
    return True


@kernel
def _refine(run, i):
    """Code the next digit of a significant coefficient."""
    fields, values, nodes = run.fields, run.values, run.nodes
    plane = fields[PLANE]
    band = run.bands[nodes[i, BAND]]
    s = np.int64(band[STRIDE])
    h = abs(np.int64(values[i - 1])) + abs(np.int64(values[i + 1]))
    v = abs(np.int64(values[i - s])) + abs(np.int64(values[i + s]))
    parent = abs(np.int64(values[nodes[i, PARENT]]))
    value = np.int64(values[i])
    now = abs(value)
    age = min(now >> (plane + 1), 4) - 1
    first = age * 10 + min(_level(h + v, plane + 1), 9)
    second = (age * 8 + min(np.int64(band[LEVEL]), 7)) * 2 + min(np.int64(band[COMPONENT]), 1)
    third = age * 5 + min(_level(parent, plane), 9) // 2
    digit = abs(np.int64(nodes[i, TARGET])) >> plane & 1
    bit = _decide(run, _REFINEMENT, first, second, third, age, digit > 0)
    if fields[STOPPED]:
        return
    threshold = np.int64(1) << plane
    after = now + bit * threshold
    values[i] = after if value > 0 else -after
    nodes[i, LAST_PLANE] = plane
    exact = run.exact[i]
    before = now + 2 * threshold * (FIRST_POINT - 1.0 if now == 2 * threshold else LATER_POINT)
    run.curve[-1] += (exact - after - LATER_POINT * threshold) ** 2 - (exact - before) ** 2


@kernel
def _signs(a, b):
    """Return the sign of the sum of the signs of two values."""
    both = int(a > 0) - int(a < 0) + int(b > 0) - int(b < 0)
    return min(max(both, -1), 1)


@kernel
def _code_sign(run, i, negative):
    """Code a sign relative to that which those around it suggest."""
    values, nodes = run.values, run.nodes
    band = run.bands[nodes[i, BAND]]
    s, kind = np.int64(band[STRIDE]), np.int64(band[KIND])
    h, v = _signs(values[i - 1], values[i + 1]), _signs(values[i - s], values[i + s])
    if kind == HORIZONTAL:
        h, v = v, h
    falling = _signs(values[i - s - 1], values[i + s + 1])
    rising = _signs(values[i - s + 1], values[i + s - 1])
    parent = _signs(values[nodes[i, PARENT]], 0)
    number = ((h * 3 + v) * 3 + falling) * 3 + rising
    flip = -1 if number < 0 else 1
    first = flip * (h * 3 + v) * 4 + kind
    second = flip * number
    third = kind * 3 + flip * parent + 1
    opposite = _decide(run, _SIGN, max(first, 0), second, third, kind, negative != (flip < 0))
    return -flip if opposite else flip


@kernel
def _code_set(run, node, deeper):
    """Code whether any descendant of a node is significant, or any below its children."""
    values, nodes = run.values, run.nodes
    plane = run.fields[PLANE]
    band = run.bands[nodes[node, BAND]]
    s, level = np.int64(band[STRIDE]), min(np.int64(band[LEVEL]), 7)
    near = 2 * (abs(np.int64(values[node - 1])) + abs(np.int64(values[node + 1])))
    near += 2 * (abs(np.int64(values[node - s])) + abs(np.int64(values[node + s])))
    near += abs(np.int64(values[node - s - 1])) + abs(np.int64(values[node - s + 1]))
    near += abs(np.int64(values[node + s - 1])) + abs(np.int64(values[node + s + 1]))
    near = min(_level(near, plane + 1), 11)
    beside = np.int64(nodes[node - 1, OPENED]) + np.int64(nodes[node + 1, OPENED])
    beside += np.int64(nodes[node - s, OPENED]) + np.int64(nodes[node + s, OPENED])
    corners = np.int64(nodes[node - s - 1, OPENED]) + np.int64(nodes[node - s + 1, OPENED])
    corners += np.int64(nodes[node + s - 1, OPENED]) + np.int64(nodes[node + s + 1, OPENED])
    own = min(_level(abs(np.int64(values[node])), plane), 8) // 2
    children = np.int64(0)
    if deeper:
        for k in range(_num_children(nodes, node)):
            children += abs(np.int64(values[_child(run, node, k)]))
        children = min(_level(children, plane), 7)
    kind = 1 if deeper else 0
    first = ((kind * 5 + beside) * 5 + corners) * 5 + own
    second = ((kind * 8 + level) * 5 + own) * 3 + min(beside, 2)
    third = ((kind * 2 + min(np.int64(band[COMPONENT]), 1)) * 12 + near) * 8 + children
    largest = np.int64(nodes[node, LARGEST_DEEPER if deeper else LARGEST_BELOW])
    weights = kind * 16 + level * 2 + min(beside, 1)
    return _decide(run, _SET, first, second, third, weights, largest >> plane > 0) > 0


@kernel
def _decide(run, kind, first, second, third, mixer, decision):
    """Code a decision, its probability mixed of those of three contexts; 0 once the data are used up."""
    fields = run.fields
    if fields[STOPPED]:
        return 0
    if not run.adaptive:
        return _code_if_settled(run, 0.5, decision)
    first, second, third = first + kind[0], second + kind[1], third + kind[2]
    probability = mixed_probability(run.mixture, first, second, third, mixer + kind[3])
    bit = _code_if_settled(run, probability, decision)
    if not fields[STOPPED]:
        learn_mixed(run.mixture, first, second, third, mixer + kind[3], probability, bit)
    return bit


@kernel
def _code_if_settled(run, probability, decision):
    """Code a decision, or stop: reading where the data do not tell it, writing where there is no room."""
    fields = run.coder.fields
    position = np.int64(fields[POSITION])
    if fields[READING]:
        stopped = not is_settled(run.coder, probability, run.num_bytes)
    else:
        stopped = 4 * position > run.num_bytes
        run.curve[position] = run.curve[-1]
    if stopped:
        run.fields[STOPPED] = 1
        return 0
    return code_decision(run.coder, probability, 1 if decision else 0)
