"""Plane sweep: the inverse depth of every pixel of a view, or of the blocks of a view without a picture.

For every pixel and every depth hypothesis (a plane of constant inverse depth) the levels of two pictures, and
their gradients or census bits, are compared at the positions given by the warp. Blocks of a virtual view are
matched along their epipolar lines in two pictures ([Maitre2008] Sec. 5.3.2).
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.geometry.label_inference import semi_global
from dvc.geometry.matching_costs import census_bits, count_bits
from dvc.geometry.warping import warp_point, warp_points

Costs = NDArray[np.int16]
Luma = Bytes

MAX_CELLS = 48_000_000
"""Largest number of pixels times hypotheses of a cost volume; it bounds the memory."""
LEVEL_LIMIT, GRADIENT_LIMIT = 30, 60
"""Truncation of differences of levels and gradients, in luma levels: larger ones are wrong or hidden."""
GRADIENT_WEIGHT = 3.0
"""Weight of a gradient relative to a level; gradients survive changes of exposure, not quantisation."""
OUTSIDE_COST = 30
"""Cost of a point outside the other picture: that of a wrong one, so that borders do not attract it."""
CENSUS_LEVEL_LIMIT, CENSUS_BIT_COST, CENSUS_OUTSIDE_COST = np.float32(20.0), 4, 45
"""Truncation of a difference of levels next to census bits, cost of a bit, and cost of a point outside."""
PRIOR_WEIGHT, PRIOR_LIMIT = 8.0, 24.0
"""Cost of the distance from an expected depth, per hypothesis, and its truncation below a wrong match."""
STEPS = np.int32(32)
"""Fractions of a pixel to which positions are rounded."""
LANE, LANE_MASK = np.uint64(21), (1 << 21) - 1
"""Bits of each of three numbers in a word; they hold 2047 times the square of the fractions."""
GOLDEN_STEPS = 6
"""Steps of the golden-section search; each keeps 0.618 of the interval."""
MIN_PARALLAX_PX = 0.05
"""Smallest displacement of a block by a search over two hypotheses that changes its depth."""


@dataclass(frozen=True)
class SweepSettings:
    """Spacing of the planes and smoothness of the result."""

    # parallax between neighbouring hypotheses, at the 95th percentile of the picture
    step_px: float = 0.6
    max_hypotheses: int = 160
    # cost of a change of depth by one hypothesis, and of a larger one across equal levels
    small_jump: int = 8
    large_jump: int = 100
    near_margin: float = 0.2  # extension of the range beyond the nearest known point, as a share of it
    census: bool = False  # whether census bits are compared instead of gradients


GRADIENT_SWEEP = SweepSettings()
"""Default settings."""
CENSUS_SWEEP = SweepSettings(
    step_px=1.0, max_hypotheses=96, small_jump=14, large_jump=500, near_margin=0.5, census=True
)
"""Coarser settings with stiffer surfaces, which make other errors."""


class DepthHypotheses(NamedTuple):
    """Inverse depths to try: ``lowest + k * step``."""

    lowest: float  # first inverse depth, and distance to the next
    step: float
    num_hypotheses: int  # number of hypotheses, at least 2

    def inverse_depth(self, hypothesis: Floats) -> Floats:
        """Return the inverse depths of hypotheses."""
        return self.lowest + self.step * hypothesis


def depth_hypotheses(
    inverse_depth_range: tuple[float, float], warp: Floats, shape: tuple[int, int], settings: SweepSettings
) -> DepthHypotheses:
    """Choose the hypotheses from the range of the inverse depths of known points."""
    lowest, highest = inverse_depth_range
    span = max(highest - lowest, 1e-6 * max(abs(lowest), abs(highest), 1e-3))
    lowest, highest = lowest - 0.1 * span, highest + settings.near_margin * span
    steps = parallax_px((lowest, highest), warp, shape) / settings.step_px
    most = min(settings.max_hypotheses, MAX_CELLS // (shape[0] * shape[1]))
    count = int(np.clip(np.ceil(steps) + 1, 4, max(most, 4)))
    return DepthHypotheses(float(lowest), float((highest - lowest) / (count - 1)), count)


def parallax_px(inverse_depths: tuple[float, float], warp: Floats, shape: tuple[int, int]) -> float:
    """Return the displacement of points under a change of depth."""
    height, width = shape
    x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
    points = np.column_stack([x.ravel(), y.ravel()])
    (far, far_seen), (near, near_seen) = (
        warp_points(warp, points, np.full(81, rho)) for rho in inverse_depths
    )
    both = far_seen & near_seen
    parallax = np.hypot(*(near - far)[both].T) if both.any() else np.zeros(1)
    return float(np.quantile(np.minimum(parallax, max(shape)), 0.95))


def sweep_views(
    base: Luma,
    other_views: Sequence[tuple[Luma, Floats]],
    hypotheses: DepthHypotheses,
    settings: SweepSettings,
    prior: tuple[Floats, Mask] | None = None,
) -> tuple[Floats, Floats]:
    """Find the inverse depth of every pixel, and its confidence, from other views with the warp to each.

    For every pixel and hypothesis the two best views count: the point may be hidden in the rest.
    """
    if not other_views:
        raise ValueError("`other_views` must hold at least one view")
    best = _costs(base, *other_views[0], hypotheses, settings.census)
    second: Costs | None = None
    for other in other_views[1:]:
        cost = _costs(base, *other, hypotheses, settings.census)
        larger = np.maximum(best, cost)
        second = larger if second is None else np.minimum(second, larger, out=second)
        np.minimum(best, cost, out=best)
    if second is not None:
        best += second
        best //= 2
    mean = _box_mean(best)
    if prior is not None:
        _add_prior(*prior, hypotheses.lowest, hypotheses.step, mean)
    chosen, confidence = semi_global(mean, base, settings.small_jump, settings.large_jump)
    return hypotheses.inverse_depth(chosen), confidence


@kernel
def _add_prior(expected, defined, low, step, cost):
    """Add the truncated distance of each hypothesis from an expected inverse depth, if defined."""
    height, width, count = cost.shape
    for y in range(height):
        for x in range(width):
            if not defined[y, x]:
                continue
            position = (expected[y, x] - low) / step
            for k in range(count):
                cost[y, x, k] += np.int16(min(PRIOR_WEIGHT * abs(k - position), PRIOR_LIMIT))


def _costs(base: Luma, other: Luma, warp: Floats, hypotheses: DepthHypotheses, census: bool) -> Costs:
    lowest, step, count = hypotheses
    cost = np.empty((*base.shape, count), np.int16)
    if census:
        levels, other_levels = base.astype(np.float32), other.astype(np.float32)
        bits = census_bits(levels), census_bits(other_levels)
        _census_cost(levels, bits[0], other_levels, bits[1], warp, lowest, step, cost)
    else:
        _matching_cost(packed_features(base), packed_features(other), warp, lowest, step, cost)
    return cost


@kernel
def _matching_cost(base, other, warp, low, step, cost):
    """Compute the truncated difference of features packed in words, three interpolated at once."""
    height, width = base.shape
    us, vs = np.empty(cost.shape[2]), np.empty(cost.shape[2])
    offsets, fractions = np.empty(us.size, np.int32), np.empty((2, us.size), np.int32)
    samples, line, mask = other.ravel(), np.uint64(width), np.uint64(LANE_MASK)
    scale = np.int64(2 * STEPS * STEPS)
    level_limit, gradient_limit = LEVEL_LIMIT * scale, GRADIENT_LIMIT * scale
    for y in range(height):
        for x in range(width):
            _warp_hypotheses(warp, x, y, low, step, us, vs)
            _round_positions(us, vs, width, height, offsets, fractions)
            word = base[y, x] * np.uint64(STEPS * STEPS)
            level, horizontal = np.int64(word & mask), np.int64((word >> LANE) & mask)
            vertical = np.int64(word >> (LANE + LANE))
            for k in range(us.size):
                if offsets[k] < 0:
                    cost[y, x, k] = OUTSIDE_COST
                    continue
                at = np.uint64(offsets[k])
                right, down = np.uint64(fractions[0, k]), np.uint64(fractions[1, k])
                left, up = np.uint64(STEPS) - right, np.uint64(STEPS) - down
                upper = left * samples[at] + right * samples[at + np.uint64(1)]
                lower = left * samples[at + line] + right * samples[at + line + np.uint64(1)]
                there = up * upper + down * lower
                total = min(abs(np.int64(there & mask) - level), level_limit)
                total += min(abs(np.int64((there >> LANE) & mask) - horizontal), gradient_limit)
                total += min(abs(np.int64(there >> (LANE + LANE)) - vertical), gradient_limit)
                cost[y, x, k] = total // scale


@kernel
def _round_positions(us, vs, width, height, offsets, fractions):
    """Round positions: offsets of the pixel at the upper left (-1 outside), and fractions in steps."""
    for k in range(us.size):
        inside = (us[k] >= 0.0) & (us[k] <= width - 1.0) & (vs[k] >= 0.0) & (vs[k] <= height - 1.0)
        u, v = us[k] if inside else 0.0, vs[k] if inside else 0.0
        u, v = np.int32(u * STEPS + 0.5), np.int32(v * STEPS + 0.5)
        column, row = min(u // STEPS, np.int32(width - 2)), min(v // STEPS, np.int32(height - 2))
        offsets[k] = row * np.int32(width) + column if inside else np.int32(-1)
        fractions[0, k], fractions[1, k] = u - STEPS * column, v - STEPS * row


@kernel
def _warp_hypotheses(warp, x, y, low, step, us, vs):
    """Warp a point for each hypothesis; the position is far away if it is behind the other view."""
    a = warp[0, 0] * x + warp[0, 1] * y + warp[0, 2]
    b = warp[1, 0] * x + warp[1, 1] * y + warp[1, 2]
    c = warp[2, 0] * x + warp[2, 1] * y + warp[2, 2]
    for k in range(us.size):
        rho = low + k * step
        w = c + rho * warp[2, 3]
        behind = w < 1e-6
        us[k] = -1e9 if behind else (a + rho * warp[0, 3]) / w
        vs[k] = -1e9 if behind else (b + rho * warp[1, 3]) / w


def luma_features(luma: Luma) -> Singles:
    """Return the features that are compared: level and weighted gradients (3, H, W)."""
    padded = np.pad(luma.astype(np.float32), 1, mode="edge")
    horizontal = padded[1:-1, 2:] - padded[1:-1, :-2]
    vertical = padded[2:, 1:-1] - padded[:-2, 1:-1]
    weight = np.float32(0.5 * GRADIENT_WEIGHT)
    return np.stack([padded[1:-1, 1:-1], weight * horizontal, weight * vertical])


def packed_features(luma: Luma) -> NDArray[np.uint64]:
    """Return the features in half luma levels above their minimum, packed in one word (H, W)."""
    level, horizontal, vertical = (
        np.round(2.0 * feature).astype(np.int64) for feature in luma_features(luma)
    )
    least = round(-255 * GRADIENT_WEIGHT)
    parts = level, horizontal - least, vertical - least
    words = [part.astype(np.uint64) << np.uint64(k) * LANE for k, part in enumerate(parts)]
    return np.asarray(words[0] | words[1] | words[2])


@kernel
def _census_cost(levels, bits, other_levels, other_bits, warp, low, step, cost):
    """Add the truncated difference of levels and the cost of differing census bits."""
    samples, words = other_levels.ravel(), other_bits.ravel()
    height, width = levels.shape
    line = np.uint64(width)
    us, vs = np.empty(cost.shape[2]), np.empty(cost.shape[2])
    offsets, nearest = np.empty(us.size, np.int32), np.empty(us.size, np.int32)
    for y in range(height):
        for x in range(width):
            _warp_hypotheses(warp, x, y, low, step, us, vs)
            _split_positions(us, vs, width, height, offsets, nearest)
            for k in range(us.size):
                if offsets[k] < 0:
                    cost[y, x, k] = CENSUS_OUTSIDE_COST
                    continue
                at, right, down = np.uint64(offsets[k]), us[k], vs[k]
                upper = samples[at] + right * (samples[at + np.uint64(1)] - samples[at])
                at += line
                lower = samples[at] + right * (samples[at + np.uint64(1)] - samples[at])
                difference = min(abs(upper + down * (lower - upper) - levels[y, x]), CENSUS_LEVEL_LIMIT)
                different = count_bits(bits[y, x] ^ words[np.uint64(nearest[k])])
                cost[y, x, k] = np.int16(difference) + np.int16(CENSUS_BIT_COST * np.int64(different))


@kernel
def _split_positions(us, vs, width, height, offsets, nearest):
    """Split positions: offsets of the upper left pixel (-1 outside) and of the nearest; keep fractions."""
    for k in range(us.size):
        inside = (us[k] >= 0.0) & (us[k] <= width - 1.0) & (vs[k] >= 0.0) & (vs[k] <= height - 1.0)
        u, v = us[k] if inside else 0.0, vs[k] if inside else 0.0
        column, row = min(np.int32(u), np.int32(width - 2)), min(np.int32(v), np.int32(height - 2))
        offsets[k] = row * np.int32(width) + column if inside else np.int32(-1)
        nearest[k] = np.int32(v + 0.5) * np.int32(width) + np.int32(u + 0.5)
        us[k], vs[k] = u - column, v - row


@kernel
def _box_mean(cost):
    """Average each hypothesis over 3x3 pixels, with a repeated border."""
    height, width, count = cost.shape
    mean = np.empty_like(cost)
    rows = np.empty((width, count), np.int16)
    for y in range(height):
        above, here, below = cost[max(y - 1, 0)], cost[y], cost[min(y + 1, height - 1)]
        for x in range(width):
            for k in range(count):
                rows[x, k] = above[x, k] + here[x, k] + below[x, k]
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            for k in range(count):
                mean[y, x, k] = np.uint16(rows[left, k] + rows[x, k] + rows[right, k]) // np.uint16(9)
    return mean


class VirtualView(NamedTuple):
    """A view without a picture, and two pictures of its scene."""

    features: tuple[Singles, Singles]  # `luma_features` of the pictures
    warps: tuple[Floats, Floats]  # from the view to each of them
    block_px: int  # side of the view's blocks


@kernel
def block_costs(view: VirtualView, hypotheses: DepthHypotheses, spacing_px: float) -> Costs:
    """Compare two pictures along the epipolar lines through each block of a virtual view [Maitre2008]."""
    (first, second), (to_first, to_second), block = view
    low, step, count = hypotheses
    height, width = first.shape[1:]
    cost = np.empty((-(-height // block), -(-width // block), count), np.int16)
    for i in range(cost.shape[0]):
        for j in range(cost.shape[1]):
            left = (j + 0.5) * block - 0.5 - 1.5 * spacing_px
            top = (i + 0.5) * block - 0.5 - 1.5 * spacing_px
            for hypothesis in range(count):
                total = 0.0
                rho = low + hypothesis * step
                for k in range(16):
                    x, y = left + (k % 4) * spacing_px, top + (k // 4) * spacing_px
                    a, b, _ = warp_point(to_first, x, y, rho)
                    c, d, _ = warp_point(to_second, x, y, rho)
                    if not (_inside(a, b, width, height) and _inside(c, d, width, height)):
                        total += OUTSIDE_COST
                        continue
                    for m in range(3):
                        difference = _bilinear(first[m], a, b) - _bilinear(second[m], c, d)
                        total += min(abs(difference), np.float32(LEVEL_LIMIT if m == 0 else GRADIENT_LIMIT))
                cost[i, j, hypothesis] = np.int16(total / 16.0)
    return cost


@kernel
def refine_blocks(view: VirtualView, depth: Floats, reach: float, window_radius_px: int) -> Floats:
    """Refine the inverse depth of each block within `reach` by golden sections, if it moves enough."""
    (first_features, second_features), (to_first, to_second), block = view
    first, second, half = first_features[0], second_features[0], window_radius_px
    golden, refined = 0.6180339887498949, depth.copy()
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            x, y, rho = (j + 0.5) * block - 0.5, (i + 0.5) * block - 0.5, depth[i, j]
            low, high = rho - reach, rho + reach
            parallax = 0.0
            for warp in (to_first, to_second):
                a, b, _ = warp_point(warp, x, y, low)
                c, d, _ = warp_point(warp, x, y, high)
                parallax = parallax + abs(c - a) + abs(d - b)
            if parallax < MIN_PARALLAX_PX:
                continue
            start = _block_error(first, second, to_first, to_second, x, y, rho, half)
            a, b = high - golden * (high - low), low + golden * (high - low)
            at_a = _block_error(first, second, to_first, to_second, x, y, a, half)
            at_b = _block_error(first, second, to_first, to_second, x, y, b, half)
            for _ in range(GOLDEN_STEPS):
                if at_a <= at_b:
                    high, b, at_b = b, a, at_a
                    a = high - golden * (high - low)
                    at_a = _block_error(first, second, to_first, to_second, x, y, a, half)
                else:
                    low, a, at_a = a, b, at_b
                    b = low + golden * (high - low)
                    at_b = _block_error(first, second, to_first, to_second, x, y, b, half)
            if min(at_a, at_b) < start:
                refined[i, j] = a if at_a <= at_b else b
    return refined


@kernel
def _block_error(first, second, to_first, to_second, x, y, rho, half):
    """Return the mean squared difference over a window around a point; huge if it leaves a picture."""
    height, width = first.shape
    total = 0.0
    for dy in range(-half, half + 1):
        for dx in range(-half, half + 1):
            a, b, _ = warp_point(to_first, x + dx, y + dy, rho)
            c, d, _ = warp_point(to_second, x + dx, y + dy, rho)
            if not (_inside(a, b, width, height) and _inside(c, d, width, height)):
                return 1e9
            difference = _bilinear(first, a, b) - _bilinear(second, c, d)
            total += difference * difference
    return total / ((2 * half + 1) * (2 * half + 1))


@kernel
def _bilinear(plane, x, y):
    """Interpolate a plane linearly inside the image."""
    height, width = plane.shape
    x0, y0 = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - x0, y - y0
    upper = plane[y0, x0] + fx * (plane[y0, x0 + 1] - plane[y0, x0])
    lower = plane[y0 + 1, x0] + fx * (plane[y0 + 1, x0 + 1] - plane[y0 + 1, x0])
    return upper + fy * (lower - upper)


@kernel
def _inside(x, y, width, height):
    """Return whether a position lies between pixel centres."""
    return 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0
