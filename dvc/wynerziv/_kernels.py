"""Compiled loops of Wyner-Ziv coding: a frame to words of bits, and the Laplacian of its coefficients."""

import numpy as np

from dvc._jit import kernel
from dvc.entropy.binarisation import NUM_EXPONENTS, code_exp_golomb
from dvc.entropy.mixing import code_adaptive
from dvc.entropy.range_coder import FAILED

_LOG2E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.693147180369123816490, 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5 * 2**52: a sum with it has been rounded to an integer, in its last bits
_MIN_EXPONENT = -700.0
_HALF_MANTISSA = 0x3FE0000000000000
_SQRT_HALF = 0.7071067811865476
_NARROW = 1e-3  # width of an interval, in scales, below which a Laplacian is constant on it
BIN_CONTEXTS = 2 + 2 * NUM_EXPONENTS  # contexts of a difference: zero, sign, exponents and mantissas
AREA_CONTEXTS = 8
SURROUNDINGS = 3  # classes of the differences of adjacent bins, and of those of earlier bands
_HALVINGS = 5  # 32 probabilities above the share of outliers have a product that is a normal number


@kernel
def count_planes(extremes, scale, origins, step, planes):
    """Count planes of embedded bins for values between scaled `extremes` (B, 2); `origins`: (B, max + 1)."""
    most = origins.shape[1] - 1
    for band in range(planes.size):
        least, greatest = extremes[band, 0] * scale[band] / step, extremes[band, 1] * scale[band] / step
        for count in range(most + 1):
            first = -origins[band, count]
            if count == most or (first <= least and greatest < (1 << count) + first):
                planes[band] = count
                break


@kernel
def pack_uniform(core, scale, step, origins, num_planes, words):
    """Quantise bands (B, N) from `origins` steps below zero up: plane p is bit 63 - p % 64 of row p // 64."""
    numbers = np.empty(core.shape[1], np.int32)
    first_plane = np.int64(0)
    for band in range(core.shape[0]):
        line, unit, origin = core[band], np.float32(scale[band] / step), np.float32(origins[band])
        last = np.int32((1 << num_planes[band]) - 1)
        if last > 0:
            for n in range(line.size):
                number = np.int32(np.float32(np.float32(line[n]) * unit) + origin)
                numbers[n] = min(max(number, np.int32(0)), last)
            put_bits(numbers, num_planes[band], first_plane, words)
        first_plane += num_planes[band]


@kernel
def pack_dead_zone(core, scale, step, num_planes, first_plane, words):
    """Quantise an AC band (doubled zero bin) and put its planes into `words`."""
    max_number = (1 << (num_planes - 1)) - 1
    per_step = 1.0 / step
    numbers = np.empty(core.size, np.int32)
    for n in range(core.size):
        value = (core[n] * scale) * per_step
        above, below = np.int32(value), np.int32(-value)
        below -= np.int32(below > 0) & np.int32(below == -value)  # a border belongs to the bin above it
        numbers[n] = max_number + min(max(above, 0), max_number) - min(max(below, 0), max_number)
    put_bits(numbers, num_planes, first_plane, words)


@kernel
def put_bits(numbers, num_planes, first_plane, words):
    """Set the planes of one band, most significant first, in one word or across two."""
    row = first_plane >> 6
    spare = 64 * (row + 1) - first_plane - num_planes
    line = words[row]
    if spare >= 0:
        for n in range(numbers.size):
            line[n] |= np.uint64(numbers[n]) << np.uint64(spare)
        return
    following = words[row + 1]
    for n in range(numbers.size):
        line[n] |= np.uint64(numbers[n]) >> np.uint64(-spare)
        following[n] |= np.uint64(numbers[n]) << np.uint64(64 + spare)


@kernel
def take_bits(num_planes, first_plane, words, numbers):
    """Read the planes of one band; inverse of `put_bits`."""
    row, last = first_plane >> 6, np.uint64((1 << num_planes) - 1)
    spare = 64 * (row + 1) - first_plane - num_planes
    for n in range(numbers.size):
        if spare >= 0:
            bits = words[row, n] >> np.uint64(spare)
        else:
            bits = (words[row, n] << np.uint64(-spare)) | (words[row + 1, n] >> np.uint64(64 + spare))
        numbers[n] = np.int32(bits & last)


@kernel
def code_band(coder, counts, band, planes, zero, columns, words, energy):
    """Code the bins of a band from its planes in words, or decode them into zeroed words.

    `planes`: how many, and the first; `zero`: the bin of zero; `energy`: bins of AC bands before, added up.
    """
    num_planes, first_plane = planes
    numbers = np.empty(words.shape[1], np.int32)
    take_bits(num_planes, first_plane, words, numbers)
    for n in range(numbers.size):
        inside, below = n % columns > 0, n >= columns
        left = numbers[n - 1] if inside else zero
        above = numbers[n - columns] if below else zero
        predicted, base = zero, zero
        if band == 0:
            base = numbers[n - columns - 1] if inside and below else zero
            predicted = min(max(left + above - base, min(left, above)), max(left, above))
        around = min(abs(left - base) + abs(above - base), SURROUNDINGS - 1)
        first = (min(energy[n], SURROUNDINGS - 1) * SURROUNDINGS + around) * BIN_CONTEXTS
        exponents, mantissas = first + 2, first + 2 + NUM_EXPONENTS
        difference = code_exp_golomb(
            coder, counts, first, first + 1, exponents, mantissas, numbers[n] - predicted
        )
        if not 0 <= predicted + difference < 1 << num_planes:
            coder.fields[FAILED] = 1
            return
        numbers[n] = predicted + difference
        if band > 0:
            energy[n] += abs(difference)
    put_bits(numbers, num_planes, first_plane, words)


@kernel
def pick_bits(words, planes, areas, chosen, bits):
    """Write bits of planes, one after the other, in blocks of chosen areas.

    `words`: (W, N), a bit for each plane; `areas`: (N,), of blocks; `chosen`: (planes, areas).
    """
    count = 0
    for k in range(planes.size):
        row, shift = words[planes[k] // 64], np.uint64(63 - planes[k] % 64)
        for n in range(row.size):
            if chosen[k, areas[n]]:
                bits[count] = (row[n] >> shift) & np.uint64(1)
                count += 1


@kernel
def code_areas(coder, counts, flags):
    """Code the chosen areas: 0 or 1 each, in raster order, from those to the left, above and above left."""
    for r in range(flags.shape[0]):
        for c in range(flags.shape[1]):
            context = 0
            if c > 0:
                context += flags[r, c - 1]
            if r > 0:
                context += 2 * flags[r - 1, c]
                if c + 1 < flags.shape[1]:
                    context += 4 * flags[r - 1, c + 1]
            flags[r, c] = code_adaptive(coder, counts, context, np.int64(flags[r, c]))


# exp and log of our own: those of libraries differ between processors in their last digit, which the decoder
# must not.


@kernel
def exponential(x):
    """Return 2**n and q such that exp(x) = 2**n * (1 + q), and |q| < 0.42, for -700 <= x <= 0."""
    rounded = max(x, _MIN_EXPONENT) * _LOG2E + _ROUND
    whole = rounded - _ROUND
    power = np.int64((np.float64(rounded).view(np.int64) + np.int64(1023)) << np.int64(52)).view(np.float64)
    r = (max(x, _MIN_EXPONENT) - whole * _LN2_HIGH) - whole * _LN2_LOW
    q = 1.0 / 6227020800.0
    q = q * r + 1.0 / 479001600.0
    q = q * r + 1.0 / 39916800.0
    q = q * r + 1.0 / 3628800.0
    q = q * r + 1.0 / 362880.0
    q = q * r + 1.0 / 40320.0
    q = q * r + 1.0 / 5040.0
    q = q * r + 1.0 / 720.0
    q = q * r + 1.0 / 120.0
    q = q * r + 1.0 / 24.0
    q = q * r + 1.0 / 6.0
    q = q * r + 0.5
    return power, r + r * r * q


@kernel
def split_exponent(x):
    """Return m in [1/2, 1) and n such that x = m * 2**n, for normal x > 0."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits >> np.int64(52)) - np.int64(1022)
    mantissa = np.int64((bits & np.int64(0xFFFFFFFFFFFFF)) | np.int64(_HALF_MANTISSA))
    return mantissa.view(np.float64), exponent


@kernel
def logarithm(x):
    """Return log(x) for normal x > 0, by the series of artanh."""
    m, exponent = split_exponent(x)
    if m < _SQRT_HALF:
        m *= 2.0
        exponent -= 1
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    total = 1.0 / 21.0
    for k in range(9, -1, -1):
        total = total * z + 1.0 / (2 * k + 1)
    return 2.0 * s * total + exponent * (_LN2_HIGH + _LN2_LOW)


@kernel
def _tails(lower, upper, side_information, start, stop):
    """Write the ends of intervals relative to the side information, those above it mirrored."""
    for n in range(lower.size):
        below, above = lower[n] - side_information[n], upper[n] - side_information[n]
        start[n] = -above if below > 0.0 else below
        stop[n] = -below if below > 0.0 else above


@kernel
def interval_probability(lower, upper, side_information, scale, probability):
    """Write the probability of every interval under a Laplacian; far out, by the mirrored tail."""
    start, stop = np.empty(lower.size), np.empty(lower.size)
    _tails(lower, upper, side_information, start, stop)
    for n in range(lower.size):
        power, q = exponential(start[n] / scale[n])
        tail = 0.5 * (power + power * q)
        power, q = exponential(-abs(stop[n]) / scale[n])
        end = 0.5 * (power + power * q)
        end = end if stop[n] < 0.0 else 1.0 - end
        probability[n] = max(end - tail, 0.0)


@kernel
def bit_llr(lower, middle, upper, side_information, scale, outliers, llr):
    """Write log P(0) / P(1) of the next bit, with a share of a uniform distribution mixed in."""
    one = np.empty(lower.size)
    interval_probability(lower, middle, side_information, scale, llr)
    interval_probability(middle, upper, side_information, scale, one)
    for n in range(lower.size):
        per_width = (outliers * (llr[n] + one[n]) + 1e-12) / max(upper[n] - lower[n], 1e-9)
        one[n] += per_width * (upper[n] - middle[n]) + 1e-15
        llr[n] += per_width * (middle[n] - lower[n]) + 1e-15
    for n in range(lower.size):
        llr[n] = logarithm(llr[n] / one[n])


@kernel
def _log_product(factors):
    """Return the logarithm of the product of numbers in (1e-9, 1], which are overwritten."""
    size = factors.size
    for _ in range(_HALVINGS):
        half = (size + 1) // 2
        kept, others = factors[:half], factors[half:size]
        for n in range(others.size):
            kept[n] *= others[n]
        size = half
    product, exponent = 1.0, np.int64(0)
    for n in range(size):
        product, more = split_exponent(product * factors[n])
        exponent += more
    return logarithm(product) + exponent * (_LN2_HIGH + _LN2_LOW)


@kernel
def log_likelihoods(lower, upper, side_information, scale, gains, per_octave, outliers, scores):
    """Write the log likelihood of all intervals together for each gain."""
    start, stop = np.empty(lower.size), np.empty(lower.size)
    _tails(lower, upper, side_information, start, stop)
    tail, end, probability = np.empty(lower.size), np.empty(lower.size), np.empty(lower.size)
    for largest in range(gains.size - 1, max(gains.size - 1 - per_octave, -1), -1):
        for n in range(lower.size):
            rate = 1.0 / (scale[n] * gains[largest])
            power, q = exponential(start[n] * rate)
            tail[n] = power + power * q
            power, q = exponential(-abs(stop[n]) * rate)
            end[n] = power + power * q
        for g in range(largest, -1, -per_octave):
            for n in range(lower.size):
                below = 0.5 * end[n] if stop[n] < 0.0 else 1.0 - 0.5 * end[n]
                probability[n] = max(below - 0.5 * tail[n], 0.0) * (1.0 - outliers) + outliers
            scores[g] = _log_product(probability)
            for n in range(lower.size):
                tail[n] *= tail[n]
                end[n] *= end[n]


@kernel
def _one_sided(width, scale):
    """Return mass and mean offset of exp(-t / scale) on [0, width]; for narrow bins, the limit."""
    ratio = width / scale
    power, q = exponential(-ratio)
    mass = (1.0 - power) - power * q
    if ratio < 1e-3:
        return mass, 0.5 * width
    return mass, scale - width * (power + power * q) / mass


@kernel
def conditional_mean(lower, upper, side_information, scale, mean):
    """Write the mean of each Laplacian over its bin."""
    for n in range(mean.size):
        split = min(max(side_information[n], lower[n]), upper[n])
        left_mass, left_offset = _one_sided(split - lower[n], scale[n])
        right_mass, right_offset = _one_sided(upper[n] - split, scale[n])
        # Outside the bin only one side has any width, and the common factor exp(-distance) cancels.
        total = left_mass + right_mass
        if total > 0.0:
            split += (right_mass * right_offset - left_mass * left_offset) / total
        mean[n] = min(max(split, lower[n]), upper[n])


@kernel
def _cumulative_moments(border, scale, near, moments):
    """Write mass, mean and square of exp(-(|s| - near) / scale) / scale up to `border`, up to a constant."""
    distance = abs(border)
    power, q = exponential((near - distance) / scale)
    tail = power + power * q
    sign = -1.0 if border < 0.0 else 1.0
    below = 1.0 if near == 0.0 else 0.0  # mass between zero and infinity, where zero lies within
    moments[0] = sign * (below - tail)
    moments[1] = below * scale - (distance + scale) * tail
    moments[2] = sign * (
        2.0 * below * scale * scale - (distance * (distance + 2 * scale) + 2 * scale * scale) * tail
    )


@kernel
def _add_uniform(lower, upper, mass, moments):
    """Add the moments of a uniform distribution of some mass on an interval."""
    moments[0] += mass
    moments[1] += 0.5 * mass * (lower + upper)
    moments[2] += mass * (lower * lower + lower * upper + upper * upper) / 3.0


@kernel
def _cell_moments(borders, scale, near, outliers, moments):
    """Write mass, mean and square, times mass, of the cells between borders; the masses have any sum."""
    count = borders.size - 1
    width = borders[count] - borders[0]
    ends = np.empty((2, 3))
    _cumulative_moments(borders[0], scale, near, ends[0])
    for k in range(count):
        lower, upper = borders[k], borders[k + 1]
        now, after = ends[k & 1], ends[1 - (k & 1)]
        _cumulative_moments(upper, scale, near, after)
        for m in range(3):
            moments[k, m] = after[m] - now[m]
        if upper - lower < _NARROW * scale:
            power, q = exponential((near - 0.5 * abs(lower + upper)) / scale)
            moments[k] = 0.0
            _add_uniform(lower, upper, (power + power * q) * (upper - lower) / scale, moments[k])
        _add_uniform(lower, upper, outliers * (upper - lower) / width, moments[k])


@kernel
def refinement(prefix, missing, edges, side_information, scale, outliers, bits, saved):
    """Write the expected bits and savings of the next 1, 2, ... planes: (D, N), of zeros."""
    depth, last = bits.shape[0], edges.size - 1
    count, cell_planes = 1 << depth, missing - depth
    borders, moments = np.empty(count + 1), np.empty((count, 3))
    for n in range(prefix.size):
        first = prefix[n] << missing
        for k in range(count + 1):
            borders[k] = edges[min(first + (np.int64(k) << cell_planes), last)] - side_information[n]
        if borders[count] <= borders[0]:
            continue
        near = max(borders[0], -borders[count], 0.0)
        power, q = exponential(-near / scale[n])
        share = 2.0 * outliers + 2e-12 / (power + power * q)  # share of a mass of 2 if zero lies within
        _cell_moments(borders, scale[n], near, share, moments)
        _write_levels(moments, bits[:, n], saved[:, n])


@kernel
def _write_levels(moments, bits, saved):
    """Join neighbouring cells, depth by depth; write their entropy, and the variance between them."""
    total, mean, square = 0.0, 0.0, 0.0
    for k in range(moments.shape[0]):
        total += moments[k, 0]
        mean += moments[k, 1]
        square += moments[k, 2]
    before = square - mean * mean / total
    for d in range(bits.size, 0, -1):
        entropy, within = 0.0, 0.0
        for k in range(1 << d):
            mass = moments[k, 0]
            if mass > 1e-9 * total:
                entropy -= mass * logarithm(mass / total)
                within += moments[k, 2] - moments[k, 1] * moments[k, 1] / mass
        bits[d - 1] = entropy / total * _LOG2E
        saved[d - 1] = max(before - within, 0.0) / total
        for k in range(1 << (d - 1)):
            for m in range(3):
                moments[k, m] = moments[2 * k, m] + moments[2 * k + 1, m]
