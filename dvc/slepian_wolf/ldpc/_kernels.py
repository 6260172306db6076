"""Compiled loops of syndromes and of belief propagation; validated and described by their callers."""

import numpy as np

from dvc._jit import inlined_kernel, kernel

_MAX_ODDS = 1e12  # of a bit, one way or the other
_MAX_CERTAINTY = 1.0 - 1e-7  # of a sum of bits
PAIRS = np.array([(0, 1), (0, 2), (1, 2)])
"""Of the orders in which bits meet syndrome bits."""

# ---- syndromes ----


@inlined_kernel
def _find_edges(positions, start, num_edges, num_checks, edges):
    """Write the syndrome bits of one bit of a plane, by its positions modulo their number: all distinct."""
    for j in range(num_edges):
        check = start[j] + positions[j]
        if check >= num_checks:
            check -= num_checks
        k = 0
        while k < j:
            if edges[k] == check:
                check = check + 1 if check + 1 < num_checks else 0
                k = 0
            else:
                k += 1
        edges[j] = check


@kernel
def count_thrice(num_bits, num_planes, num_checks, sparsity):
    """Count bits of a plane, the first of the last order, of three syndrome bits; `sparsity`: `numbers`."""
    max_share, low, high = sparsity[0], sparsity[1], sparsity[2]
    share = (num_checks / (num_planes * num_bits) - low) / (high - low)
    return num_bits - int(max_share * min(max(share, 0.0), 1.0) * num_bits)


@kernel
def _reduced(positions, num_thrice, num_checks, reduced, num_edges):
    """Write all positions modulo the number of syndrome bits, and in how many of them each bit takes part."""
    last = positions.shape[1] - 1
    for n in range(positions.shape[0]):
        num_edges[n] = positions.shape[1] if positions[n, last] < num_thrice else last
        for j in range(positions.shape[1]):
            reduced[n, j] = positions[n, j] % num_checks


@kernel
def list_edges(positions, starts, num_thrice, num_checks, edges):
    """Write the syndrome bits of all bits of a block; -1 in place of one that a bit has not."""
    edges[:] = -1
    reduced, num_edges = np.empty(positions.shape, np.int64), np.empty(positions.shape[0], np.int64)
    _reduced(positions, num_thrice, num_checks, reduced, num_edges)
    for i in range(edges.shape[0]):
        for n in range(edges.shape[1]):
            _find_edges(reduced[n], starts[i], num_edges[n], num_checks, edges[i, n])


@inlined_kernel
def _fold(row, order, num_placed, folded):
    """Add up the words at the first positions of an order, modulo 2, all around as many as `folded` has."""
    size = np.int64(folded.size)
    for r in range(size):
        folded[r] = row[np.uintp(order[r])] if r < num_placed else np.uint64(0)
    for first in range(size, num_placed, size):
        for r in range(min(size, num_placed - first)):
            folded[r] ^= row[np.uintp(order[np.uintp(first + r)])]


@inlined_kernel
def _add_plane(folded, start, mask, sums):
    """Add the bits of a plane to the syndrome from `start` on and all around."""
    num_before = min(folded.size, sums.size - start)
    for r in range(num_before):
        sums[np.uintp(start + r)] ^= np.uint8((folded[np.uintp(r)] & mask) != 0)
    for r in range(num_before, folded.size):
        sums[np.uintp(start + r - sums.size)] ^= np.uint8((folded[np.uintp(r)] & mask) != 0)


@inlined_kernel
def _separate(start, positions, num_edges, reduced, edges, sums):
    """Take back what was added of a bit where its positions meet; add it to the syndrome bits that it has."""
    num_checks = np.uint32(sums.size)
    for j in range(num_edges):
        reduced[j] = np.uint32(positions[j]) % num_checks
        sums[np.uint32(start[j] + reduced[j]) % num_checks] ^= np.uint8(1)
    _find_edges(reduced, start, num_edges, sums.size, edges)
    for j in range(num_edges):
        sums[edges[j]] ^= np.uint8(1)


@kernel
def _separate_all(line, shift, start, orders, num_thrice, sums):
    """Correct the sums of a plane for all its ones of which two positions meet."""
    num_bits, num_orders = orders.positions.shape
    reduced, edges = np.empty(num_orders, np.int64), np.empty(num_orders, np.int64)
    for pair in range(PAIRS.shape[0]):
        j, k = PAIRS[pair]
        difference = (start[k] - start[j]) % sums.size  # and all others that this is the remainder of
        lowest = difference - (difference + num_bits - 1) // sums.size * sums.size
        for apart in range(lowest + num_bits - 1, 2 * num_bits - 1, sums.size):
            for position in range(orders.first[pair, apart], orders.first[pair, apart + 1]):
                n = np.uintp(orders.by_difference[pair, position])
                if (line[n] >> shift) & np.uint64(1):
                    positions = orders.positions[n]
                    num_edges = num_orders if positions[num_orders - 1] < num_thrice else num_orders - 1
                    met_before = pair and (start[0] + positions[0] - start[1] - positions[1]) % sums.size == 0
                    if k < num_edges and not met_before:
                        _separate(start, positions, num_edges, reduced, edges, sums)


@kernel
def add_orders(row, shifts, starts, bits, num_thrice, folded, sums):
    """Add planes of a row of words to the syndrome as if no two positions of a bit met."""
    last, eight = bits.shape[0] - 1, np.empty(folded.size, np.uint8)
    for j in range(bits.shape[0]):
        _fold(row, bits[j], num_thrice if j == last else row.size, folded)
        narrowed = -1
        for i in range(shifts.size):
            if shifts[i] >> 3 != narrowed:
                narrowed = shifts[i] >> 3
                for r in range(folded.size):
                    eight[r] = np.uint8(folded[r] >> np.uint64(8 * narrowed))
            _add_plane(eight, starts[i, j], np.uint8(1 << (shifts[i] & 7)), sums)


@kernel
def add_planes(words, planes, orders, starts, num_thrice, syndrome):
    """Write the syndrome of the planes of a block."""
    folded = np.empty(min(words.shape[1], syndrome.size), np.uint64)
    syndrome[:] = 0
    for w in range(words.shape[0]):
        chosen = np.flatnonzero(planes >> 6 == w)
        if chosen.size:
            shifts, begins = 63 - (planes[chosen] & 63), starts[chosen]
            add_orders(words[w], shifts, begins, orders.bits, num_thrice, folded, syndrome)
            for i in range(chosen.size):
                _separate_all(words[w], np.uint64(shifts[i]), begins[i], orders, num_thrice, syndrome)


@kernel
def add_block(words, planes, code, sparsity, syndrome):
    """Write the syndrome of the planes of a block by a code; `code`: orders of bits, and keys of planes."""
    (orders, keys), num_edges = code, code[1].shape[1]
    starts = np.empty((planes.size, num_edges), np.int64)
    for i in range(planes.size):
        for j in range(num_edges):
            starts[i, j] = keys[planes[i], j] % np.uint64(syndrome.size)
    num_thrice = count_thrice(words.shape[1], planes.size, syndrome.size, sparsity)
    add_planes(words, planes, orders, starts, num_thrice, syndrome)


# ---- belief propagation ----


@kernel
def sort_edges(edges, num_checks, first, edge_of):
    """Sort edges by syndrome bit: those of bit c are `edge_of[first[c] : first[c + 1]]`; -1 is no edge."""
    first[:] = 0
    for e in range(edges.size):
        if edges[e] >= 0:
            first[edges[e] + 1] += 1
    for c in range(num_checks):
        first[c + 1] += first[c]
    position = first[:num_checks].copy()
    for e in range(edges.size):
        if edges[e] >= 0:
            edge_of[position[edges[e]]] = e
            position[edges[e]] += 1


@inlined_kernel
def _receive(messages, first_bit, n, received):
    """Write the odds that syndrome bits tell of each bit of number `n`."""
    for q in range(first_bit.size):
        product = 1.0
        for j in range(messages.shape[1]):
            product *= messages[first_bit[q] + n, j]
        received[q] = min(max(product, 1.0 / _MAX_ODDS), _MAX_ODDS)


@kernel
def from_numbers(lowest, probabilities, count, depth, outliers, received, odds):
    """Turn odds of the bits of one number into odds by these and by the prior of the number."""
    anywhere = outliers
    for q in range(depth):
        anywhere *= 0.5 * (1.0 + received[q])
    total = anywhere
    for q in range(depth):
        odds[q] = anywhere * (received[q] / (1.0 + received[q]))
    for k in range(count):
        number, weight = lowest + k, np.float64(probabilities[k])
        for q in range(depth):
            if (number >> (depth - 1 - q)) & 1:
                weight *= received[q]
        total += weight
        for q in range(depth):
            if (number >> (depth - 1 - q)) & 1:
                odds[q] += weight
    for q in range(depth):
        odds[q] = min(max(odds[q] / max(total - odds[q], total / _MAX_ODDS), 1.0 / _MAX_ODDS), _MAX_ODDS)


@kernel
def update_numbers(lowest, counts, probabilities, first_bit, outliers, messages, certainties, odds):
    """Update all bits of a band: `odds` of a one, and what each tells its syndrome bits (`certainties`)."""
    depth, num_edges = first_bit.size, messages.shape[1]
    received, found = np.empty(depth), np.empty(depth)
    for n in range(lowest.size):
        _receive(messages, first_bit, n, received)
        from_numbers(lowest[n], probabilities[n], counts[n], depth, outliers, received, found)
        for q in range(depth):
            bit = first_bit[q] + n
            odds[bit] = found[q]
            for j in range(num_edges):
                ratio = found[q] / messages[bit, j]
                certainties[bit, j] = (1.0 - ratio) / (1.0 + ratio)


@kernel
def believe(lowest, counts, probabilities, first_bit, messages, believed):
    """Write the probabilities of all candidates by their priors and by what syndrome bits tell."""
    depth = first_bit.size
    received = np.empty(depth)
    for n in range(lowest.size):
        _receive(messages, first_bit, n, received)
        total = 0.0
        weights = np.empty(counts[n])
        for k in range(counts[n]):
            weight = np.float64(probabilities[n, k])
            for q in range(depth):
                share = 1.0 / (1.0 + received[q])
                weight *= received[q] * share if ((lowest[n] + k) >> (depth - 1 - q)) & 1 else share
            weights[k] = weight
            total += weight
        for k in range(counts[n]):
            believed[n, k] = weights[k] / total if total > 0.0 else probabilities[n, k]


@kernel
def update_checks(syndrome, first, edge_of, certainties, odds, messages):
    """Update what all syndrome bits tell their bits; return how many of them decisions contradict."""
    num_edges = messages.shape[1]
    told, heard = messages.reshape(-1), certainties.reshape(-1)
    before = np.empty(edge_of.size)
    num_wrong = 0
    for c in range(syndrome.size):
        parity, product = syndrome[c], 1.0
        for position in range(first[c], first[c + 1]):
            edge = edge_of[position]
            parity ^= np.uint8(odds[edge // num_edges] > 1.0)
            before[position] = product
            product *= heard[edge]
        num_wrong += parity
        after = -1.0 if syndrome[c] else 1.0
        for position in range(first[c + 1] - 1, first[c] - 1, -1):
            edge = edge_of[position]
            certainty = min(max(before[position] * after, -_MAX_CERTAINTY), _MAX_CERTAINTY)
            told[edge] = (1.0 - certainty) / (1.0 + certainty)
            after *= heard[edge]
    return num_wrong
