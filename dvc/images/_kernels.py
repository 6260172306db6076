"""Compiled loops of the coder: passes over zerotrees, contexts, mixed probabilities.

Each function codes in both directions: it writes the decisions that the target values lead to, or reads them.
Constants that are arguments have types of numpy: numba compiles a function anew for each literal.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.mixing import Mixture, learn_mixed, mixed_probability
from dvc.entropy.range_coder import FAILED, POSITION, READING, CoderState, code_decision, is_settled

# Columns of `Run.marks`; the last two are what a writer knows.
BAND, FLAGS, LAST_PLANE, PLANES_BELOW, PLANES_DEEPER = range(5)
NUM_READER_MARKS, NUM_WRITER_MARKS = 3, 5
EXISTS, HAS_CHILDREN, HAS_GRANDCHILDREN, OPENED = np.array([1, 2, 4, 8], np.uint8)

# Columns of `Run.bands`: first node and size of a band, and the bands of its parents and children, or NONE.
FIRST, STRIDE, ROWS, COLUMNS, KIND, LEVEL, COMPONENT, ABOVE, BELOW = range(9)
NONE = -1
LOW_BAND, HORIZONTAL, VERTICAL, DIAGONAL = range(4)

# `Run.fields`: ends of the two chains of `Run.links`, lengths of `Run.sets` and `Run.opening`, position,
# how many decisions were coded.
PENDING, PENDING_END, SIGNIFICANT, SIGNIFICANT_END, SETS, OPENING, STOPPED, PLANE, DECISIONS = np.arange(9)
NUM_FIELDS = 9
MOST_CHILDREN = 9
"""Most children of a node: bands have up to one row and column more than twice those of the band above."""

# Contexts of a coefficient, a set, a refinement and a sign, in each of three tables, and weights of these.
_SIZES = (256, 256, 512, 24), (256, 256, 384, 32), (64, 64, 64, 4), (64, 64, 64, 4)
NUM_CONTEXTS, NUM_WEIGHTS = sum(sum(sizes[:3]) for sizes in _SIZES), sum(sizes[3] for sizes in _SIZES)


def _starts(kind: int) -> tuple[np.int64, ...]:
    """Return the first contexts of a kind of decision in each table, and its weights."""
    first, weights = sum(sum(sizes[:3]) for sizes in _SIZES[:kind]), sum(sizes[3] for sizes in _SIZES[:kind])
    return tuple(map(np.int64, (first, first + _SIZES[kind][0], first + sum(_SIZES[kind][:2]), weights)))


_COEFFICIENT, _SET, _REFINEMENT, _SIGN = (_starts(kind) for kind in range(4))
_SINGLE, _CHILD = np.arange(2)  # modes of coefficients
_NO, _YES = np.array([False, True])

FREE_DECISIONS, DECISIONS_PER_BYTE = 2**20, 1024
"""Most decisions of any stream, and of each byte. Ramps of 2048x2048 pixels take 20 to 160 a byte.

A writer stops half of the free ones earlier, so that a reader of any part of its bytes has enough of them.
"""
FIRST_POINT, LATER_POINT = 1.4, 0.48
"""Excess of a magnitude over its threshold, in thresholds, at first and after refinement."""


class Run(NamedTuple):
    """State of a coder: few arrays, as each access to one in a tuple costs time."""

    coder: CoderState  # where to write or to read
    # ends of chains, lengths of lists, whether the data are used up, and the bit plane
    fields: NDArray[np.int64]
    values: NDArray[np.int32]  # decoded part of coefficients, in steps, with their signs
    # of each node: band, flags, lowest plane that is known; of a writer also in how many planes there is
    # anything among descendants, and among those but children
    marks: NDArray[np.uint8]
    bands: NDArray[np.int64]  # bands of coefficients
    # the next one of coefficients that are not yet significant, or of those that are; 0 after the last
    links: NDArray[np.int32]
    sets: NDArray[np.int32]  # sets, by their nodes; those of grandchildren negative
    opening: NDArray[np.int32]  # nodes whose children are to be coded
    exact: NDArray[np.float64]  # coefficients before quantisation, in steps, of a writer; empty for a reader
    curve: NDArray[np.float64]  # squared error once each word is written, and last the one now
    mixture: Mixture  # probabilities of three contexts
    num_bytes: int  # number of bytes to read, or to write at most
    adaptive: bool  # whether decisions have contexts; else each takes a bit


@kernel
def gather_below(bands, values, below, deeper):
    """Set the largest of values among descendants of each node, and among those but children."""
    for number in range(len(bands) - 1, -1, -1):
        band = bands[number]
        if band[ABOVE] == NONE:
            continue
        for row in range(band[ROWS]):
            for column in range(band[COLUMNS]):
                i = band[FIRST] + row * band[STRIDE] + column
                parent = parent_at(bands, band, row, column)
                below[parent] = max(below[parent], values[i], below[i])
                deeper[parent] = max(deeper[parent], below[i])


@kernel
def parent_at(bands, band, row, column):
    """Return the parent of a coefficient in a band, or 0."""
    if band[ABOVE] == NONE:
        return 0
    above = bands[band[ABOVE]]
    row, column = min(row // 2, above[ROWS] - 1), min(column // 2, above[COLUMNS] - 1)
    return above[FIRST] + row * above[STRIDE] + column


@kernel
def _place(band, i):
    """Return row and column of a node in its band."""
    offset, stride = np.uint32(i - band[FIRST]), np.uint32(band[STRIDE])  # division of 64 bits is slow
    row = np.int64(offset // stride)
    return row, i - band[FIRST] - row * band[STRIDE]


@kernel
def _parent(run, band, i):
    """Return the parent of a node, or 0."""
    row, column = _place(band, i)
    return parent_at(run.bands, band, row, column)


@kernel
def _children(run, node):
    """Return the first child of a node that has any, the stride of its band, and rows and columns of them."""
    band = run.bands[run.marks[node, BAND]]
    below = run.bands[band[BELOW]]
    row, column = _place(band, node)
    rows = below[ROWS] - 2 * row if row == band[ROWS] - 1 else 2
    columns = below[COLUMNS] - 2 * column if column == band[COLUMNS] - 1 else 2
    return below[FIRST] + 2 * row * below[STRIDE] + 2 * column, below[STRIDE], rows, columns


@kernel
def _has(run, node, flag):
    return run.marks[node, FLAGS] & flag != 0


@kernel
def code_planes(run, roots, num_planes, lowest_plane):
    """Code bit planes, the highest first, to a last one or until the data or the room are used up."""
    fields, links = run.fields, run.links
    for root in roots:
        node = np.int64(root)
        if _has(run, node, EXISTS):
            _append(fields, links, PENDING, node)
        if _has(run, node, HAS_CHILDREN):
            _append_set(run, node)
    for plane in range(num_planes - 1, lowest_plane - 1, -1):
        fields[PLANE] = plane
        last = fields[SIGNIFICANT_END]
        before, i = 0, fields[PENDING]
        while i and not fields[STOPPED]:
            after = np.int64(links[i])
            if not _code_coefficient(run, i, _SINGLE, _NO):
                before = i
            else:
                if before == 0:
                    fields[PENDING] = after
                else:
                    links[before] = after
                if after == 0:
                    fields[PENDING_END] = before
            i = after
        _set_pass(run)
        i = fields[SIGNIFICANT] if last else 0
        while i and not fields[STOPPED]:
            _refine(run, i)
            i = np.int64(links[i]) if i != last else 0
        if fields[STOPPED]:
            return


@kernel
def _append(fields, links, chain, i):
    """Append a coefficient to one of the two chains."""
    if fields[chain] == 0:
        fields[chain] = i
    else:
        links[fields[chain + 1]] = i
    fields[chain + 1] = i
    links[i] = 0


@kernel
def _append_set(run, entry):
    run.sets[run.fields[SETS]] = entry
    run.fields[SETS] += 1


@kernel
def _set_pass(run):
    """Code which sets hold a significant coefficient, and all that follows from it."""
    fields, sets = run.fields, run.sets
    count, kept = fields[SETS], 0
    for k in range(count):
        entry = np.int64(sets[k])
        deeper = entry < 0
        node = abs(entry)
        if not fields[STOPPED] and _code_set(run, node, deeper):
            if deeper:
                _code_below(run, node, HAS_CHILDREN)
            else:
                _open(run, node)
            while fields[OPENING] and not fields[STOPPED]:
                fields[OPENING] -= 1
                node = np.int64(run.opening[fields[OPENING]])
                found = _code_below(run, node, EXISTS)  # implied decisions take no bits
                if not _has(run, node, HAS_GRANDCHILDREN):
                    continue
                if not found or _code_set(run, node, _YES):
                    _code_below(run, node, HAS_CHILDREN)
                else:
                    _append_set(run, -node)
        else:
            sets[kept] = entry
            kept += 1
    for k in range(count, fields[SETS]):
        sets[kept] = sets[k]
        kept += 1
    fields[SETS] = kept


@kernel
def _open(run, node):
    run.marks[node, FLAGS] |= OPENED
    run.opening[run.fields[OPENING]] = node
    run.fields[OPENING] += 1


@kernel
def _code_below(run, node, flag):
    """Code which children are significant, or with `HAS_CHILDREN` have descendants that are; return if any.

    The last one is certain if none of the earlier ones is, unless grandchildren may be instead.
    """
    first, stride, rows, columns = _children(run, node)
    is_set = flag == HAS_CHILDREN
    left, found = 0, False
    for row in range(rows):
        for column in range(columns):
            left += _has(run, first + row * stride + column, flag)
    for row in range(rows):
        for column in range(columns):
            child = first + row * stride + column
            if not _has(run, child, flag):
                continue
            left -= 1
            certain = left == 0 and not found
            if is_set:
                if certain or _code_set(run, child, _NO):
                    found = True
                    _open(run, child)
                else:
                    _append_set(run, child)
            elif _code_coefficient(run, child, _CHILD, certain and not _has(run, node, HAS_GRANDCHILDREN)):
                found = True
            else:
                _append(run.fields, run.links, PENDING, child)
    return found


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
def _code_significance(run, i, mode, plane, significant):
    """Code whether a coefficient is significant, in contexts of those around it and of its parent."""
    values, band = run.values, run.bands[run.marks[i, BAND]]
    s, kind = band[STRIDE], band[KIND]
    h = abs(np.int64(values[i - 1])) + abs(np.int64(values[i + 1]))
    v = abs(np.int64(values[i - s])) + abs(np.int64(values[i + s]))
    d = abs(np.int64(values[i - s - 1])) + abs(np.int64(values[i - s + 1]))
    d += abs(np.int64(values[i + s - 1])) + abs(np.int64(values[i + s + 1]))
    far = abs(np.int64(values[i - 2])) + abs(np.int64(values[i + 2]))
    far += abs(np.int64(values[i - 2 * s])) + abs(np.int64(values[i + 2 * s]))
    parent = abs(np.int64(values[_parent(run, band, i)]))
    if kind == HORIZONTAL:
        h, v = v, h
    shape = 0 if kind == LOW_BAND else (2 if kind == DIAGONAL else 1)
    near = _level(2 * (h + v) + d, plane + 1)
    first = (shape * 4 + min(_level(h, plane), 6) // 2) * 4 + min(_level(v, plane), 6) // 2
    first = first * 4 + min(_level(d, plane), 6) // 2
    second = (min(near, 11) * 5 + min(_level(parent, plane), 8) // 2) * 2 + mode
    third = (min(band[LEVEL], 7) * 2 + min(band[COMPONENT], 1)) * 5
    third = (third + min(_level(far, plane), 8) // 2) * 6 + min(near, 10) // 2
    return _decide(run, _COEFFICIENT, first, second, third, mode * 12 + min(near, 11), significant)


@kernel
def _code_coefficient(run, i, mode, certain):
    """Code whether a coefficient is significant and, if so, its sign; 0 too once the data are used up."""
    fields, values, marks = run.fields, run.values, run.marks
    plane = fields[PLANE]
    exact = 0.0 if run.coder.fields[READING] else run.exact[i]
    if not certain and not _code_significance(run, i, mode, plane, np.int64(abs(exact)) >> plane > 0):
        if not fields[STOPPED]:
            marks[i, LAST_PLANE] = plane
        return False
    if fields[STOPPED]:
        return False
    sign = _code_sign(run, i, exact < 0.0)
    if fields[STOPPED]:
        return False
    marks[i, LAST_PLANE] = plane
    threshold = np.int64(1) << plane
    values[i] = sign * threshold
    _append(fields, run.links, SIGNIFICANT, i)
    exact = abs(exact)
    run.curve[-1] += (exact - FIRST_POINT * threshold) ** 2 - exact * exact
    return True


@kernel
def _refine(run, i):
    """Code the next digit of a significant coefficient."""
    fields, values, marks = run.fields, run.values, run.marks
    plane = fields[PLANE]
    band = run.bands[marks[i, BAND]]
    s = band[STRIDE]
    h = abs(np.int64(values[i - 1])) + abs(np.int64(values[i + 1]))
    v = abs(np.int64(values[i - s])) + abs(np.int64(values[i + s]))
    parent = abs(np.int64(values[_parent(run, band, i)]))
    value = np.int64(values[i])
    now = abs(value)
    age = min(now >> (plane + 1), 4) - 1
    first = age * 10 + min(_level(h + v, plane + 1), 9)
    second = (age * 8 + min(band[LEVEL], 7)) * 2 + min(band[COMPONENT], 1)
    third = age * 5 + min(_level(parent, plane), 9) // 2
    exact = 0.0 if run.coder.fields[READING] else abs(run.exact[i])
    digit = np.int64(exact) >> plane & 1
    bit = _decide(run, _REFINEMENT, first, second, third, age, digit > 0)
    if fields[STOPPED]:
        return
    threshold = np.int64(1) << plane
    after = now + bit * threshold
    values[i] = after if value > 0 else -after
    marks[i, LAST_PLANE] = plane
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
    values = run.values
    band = run.bands[run.marks[i, BAND]]
    s, kind = band[STRIDE], band[KIND]
    h, v = _signs(values[i - 1], values[i + 1]), _signs(values[i - s], values[i + s])
    if kind == HORIZONTAL:
        h, v = v, h
    falling = _signs(values[i - s - 1], values[i + s + 1])
    rising = _signs(values[i - s + 1], values[i + s - 1])
    parent = _signs(values[_parent(run, band, i)], np.int32(0))
    number = ((h * 3 + v) * 3 + falling) * 3 + rising
    flip = -1 if number < 0 else 1
    first = flip * (h * 3 + v) * 4 + kind
    second = flip * number
    third = kind * 3 + flip * parent + 1
    opposite = _decide(run, _SIGN, max(first, 0), second, third, kind, negative != (flip < 0))
    return -flip if opposite else flip


@kernel
def _opened(marks, i):
    return np.int64(marks[i, FLAGS] & OPENED != 0)


@kernel
def _code_set(run, node, deeper):
    """Code whether any descendant of a node is significant, or any below its children."""
    values, marks = run.values, run.marks
    plane = run.fields[PLANE]
    band = run.bands[marks[node, BAND]]
    s, level = band[STRIDE], min(band[LEVEL], 7)
    near = 2 * (abs(np.int64(values[node - 1])) + abs(np.int64(values[node + 1])))
    near += 2 * (abs(np.int64(values[node - s])) + abs(np.int64(values[node + s])))
    near += abs(np.int64(values[node - s - 1])) + abs(np.int64(values[node - s + 1]))
    near += abs(np.int64(values[node + s - 1])) + abs(np.int64(values[node + s + 1]))
    near = min(_level(near, plane + 1), 11)
    next_to = _opened(marks, node - 1) + _opened(marks, node + 1)
    next_to += _opened(marks, node - s) + _opened(marks, node + s)
    corners = _opened(marks, node - s - 1) + _opened(marks, node - s + 1)
    corners += _opened(marks, node + s - 1) + _opened(marks, node + s + 1)
    own = min(_level(abs(np.int64(values[node])), plane), 8) // 2
    children = np.int64(0)
    if deeper:
        first, stride, rows, columns = _children(run, node)
        for row in range(rows):
            for column in range(columns):
                children += abs(np.int64(values[first + row * stride + column]))
        children = min(_level(children, plane), 7)
    kind = 1 if deeper else 0
    context = ((kind * 5 + next_to) * 5 + corners) * 5 + own
    second = ((kind * 8 + level) * 5 + own) * 3 + min(next_to, 2)
    third = ((kind * 2 + min(band[COMPONENT], 1)) * 12 + near) * 8 + children
    found = False
    if not run.coder.fields[READING]:
        found = marks[node, PLANES_DEEPER if deeper else PLANES_BELOW] > plane
    weights = kind * 16 + level * 2 + min(next_to, 1)
    return _decide(run, _SET, context, second, third, weights, found) > 0


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
    """Code a decision, or stop: a reader at the end of the data, a writer at the end of the room."""
    fields = run.coder.fields
    position = np.int64(fields[POSITION])
    run.fields[DECISIONS] += 1
    if fields[READING]:
        stopped = not is_settled(run.coder, probability, run.num_bytes) or fields[FAILED] != 0
        if run.fields[DECISIONS] > FREE_DECISIONS + DECISIONS_PER_BYTE * run.num_bytes:
            fields[FAILED] = 1
            stopped = True
    else:
        most = FREE_DECISIONS // 2 + DECISIONS_PER_BYTE * 4 * position
        stopped = 4 * position > run.num_bytes or run.fields[DECISIONS] > most
        run.curve[position] = run.curve[-1]
    if stopped:
        run.fields[STOPPED] = 1
        return 0
    return code_decision(run.coder, probability, 1 if decision else 0)
