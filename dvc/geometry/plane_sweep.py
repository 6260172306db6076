"""Plane sweep: the inverse depth of every pixel of a view, or of every block of a virtual one.

For every pixel and every depth hypothesis (a plane of constant inverse depth) the levels of two pictures, and
their gradients or census bits, are compared where the warp puts the point; semi-global inference favours
depths without jumps, and a parabola refines the best hypothesis. A virtual view has no picture: both pictures
are warped into it.

References
----------
[Maitre2008] Sec. 5.3.2: blocks of the virtual view are matched along their epipolar lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels
from dvc.geometry.census import census_bits
from dvc.geometry.inference import semi_global
from dvc.geometry.warping import warp_points

Floats = NDArray[np.float64]
Costs = NDArray[np.int16]
Luma = NDArray[np.uint8]

MAX_CELLS = 48_000_000
"""Pixels times hypotheses of a cost volume: what memory it may take."""
LEVEL_LIMIT, GRADIENT_LIMIT = 30.0, 60.0
"""Truncation of differences of levels, and of gradients, in luma levels: more is a wrong or hidden point."""
GRADIENT_WEIGHT = 3.0
"""Of a gradient against a level; gradients survive changes of exposure, and quantisation damps them."""
OUTSIDE_COST = 30
"""Cost of a point outside the other picture: that of a wrong one, so that borders do not attract it."""
CENSUS_LEVEL_LIMIT, CENSUS_BIT_COST, CENSUS_OUTSIDE_COST = 20.0, 4, 45
"""Beside census bits: truncation of a difference of levels, cost of a bit, and of a point outside."""
PRIOR_WEIGHT, PRIOR_LIMIT = 8.0, 24.0
"""Cost of the distance from an expected depth, per hypothesis, and its truncation: below a wrong match."""
GOLDEN_STEPS = 6
"""Steps of the golden-section search; each leaves 0.618 of the interval."""
MIN_PARALLAX_PX = 0.05
"""A block that a search over two hypotheses moves by less keeps its depth."""


@dataclass(frozen=True)
class SweepSettings:
    """How finely the planes are swept, and how smooth the result is."""

    # parallax between neighbouring hypotheses where it is largest, apart from the last twentieth
    step_px: float = 0.6
    max_hypotheses: int = 160  # most hypotheses
    # cost of a change of depth by one hypothesis, and of a larger one across equal levels
    small_jump: int = 8
    large_jump: int = 100
    near_margin: float = 0.2  # how far hypotheses go beyond the nearest known point, as a share of the range
    census: bool = False  # whether census bits are compared in place of gradients


GRADIENT_SWEEP = SweepSettings()
"""The usual one."""
CENSUS_SWEEP = SweepSettings(
    step_px=1.0, max_hypotheses=96, small_jump=14, large_jump=500, near_margin=0.5, census=True
)
"""A coarser one with stiffer surfaces, which errs elsewhere."""


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
    wanted = parallax_px((lowest, highest), warp, shape) / settings.step_px
    most = min(settings.max_hypotheses, MAX_CELLS // (shape[0] * shape[1]))
    count = int(np.clip(np.ceil(wanted) + 1, 4, max(most, 4)))
    return DepthHypotheses(float(lowest), float((highest - lowest) / (count - 1)), count)


def parallax_px(inverse_depths: tuple[float, float], warp: Floats, shape: tuple[int, int]) -> float:
    """Measure how far a change of depth moves points."""
    height, width = shape
    x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
    points = np.column_stack([x.ravel(), y.ravel()])
    (far, far_seen), (near, near_seen) = (
        warp_points(warp, points, np.full(81, rho)) for rho in inverse_depths
    )
    both = far_seen & near_seen
    parallax = np.hypot(*(near - far)[both].T) if both.any() else np.zeros(1)
    return float(np.quantile(np.minimum(parallax, max(shape)), 0.95))


def sweep(
    base: Luma,
    other: Luma,
    warp: Floats,
    hypotheses: DepthHypotheses,
    settings: SweepSettings,
    prior: tuple[Floats, NDArray[np.bool_]] | None = None,
) -> tuple[Floats, Floats]:
    """Find the inverse depth of every pixel of a view."""
    cost = _box((_census_costs if settings.census else _gradient_costs)(base, other, warp, hypotheses))
    if prior is not None:
        _kernels.add_prior(*prior, hypotheses.lowest, hypotheses.step, PRIOR_WEIGHT, PRIOR_LIMIT, cost)
    chosen, confidence = semi_global(cost, base, settings.small_jump, settings.large_jump)
    return hypotheses.inverse_depth(chosen), confidence


def sweep_views(
    base: Luma,
    others: Sequence[tuple[Luma, Floats]],
    hypotheses: DepthHypotheses,
    settings: SweepSettings,
) -> tuple[Floats, Floats]:
    """Find the inverse depth of every pixel from several other views, each with the warp to it.

    Of every pixel and hypothesis the two views count that agree best: the others may not see the point.
    """
    if not others:
        raise ValueError("`others` must hold at least one view")
    costs = _census_costs if settings.census else _gradient_costs
    best = costs(base, *others[0], hypotheses)
    second: Costs | None = None
    for other in others[1:]:
        cost = costs(base, *other, hypotheses)
        larger = np.maximum(best, cost)
        second = larger if second is None else np.minimum(second, larger, out=second)
        np.minimum(best, cost, out=best)
    if second is not None:
        best += second
        best //= 2
    chosen, confidence = semi_global(_box(best), base, settings.small_jump, settings.large_jump)
    return hypotheses.inverse_depth(chosen), confidence


def _gradient_costs(base: Luma, other: Luma, warp: Floats, hypotheses: DepthHypotheses) -> Costs:
    lowest, step, count = hypotheses
    cost = np.empty((*base.shape, count), np.int16)
    features = packed_features(base), packed_features(other)
    _kernels.matching_cost(*features, warp, lowest, step, _limits().astype(np.int64), OUTSIDE_COST, cost)
    return cost


def _census_costs(base: Luma, other: Luma, warp: Floats, hypotheses: DepthHypotheses) -> Costs:
    lowest, step, count = hypotheses
    cost = np.empty((*base.shape, count), np.int16)
    own, others = ((luma.astype(np.float32), census_bits(luma.astype(np.float32))) for luma in (base, other))
    limits = _kernels.CensusLimits(np.float32(CENSUS_LEVEL_LIMIT), CENSUS_BIT_COST, CENSUS_OUTSIDE_COST)
    _kernels.census_cost(own, others, warp, _kernels.Hypotheses(lowest, step), limits, cost)
    return cost


def luma_features(luma: Luma) -> NDArray[np.float32]:
    """Return what is compared of a picture."""
    padded = np.pad(luma.astype(np.float32), 1, mode="edge")
    horizontal = padded[1:-1, 2:] - padded[1:-1, :-2]
    vertical = padded[2:, 1:-1] - padded[:-2, 1:-1]
    weight = np.float32(0.5 * GRADIENT_WEIGHT)
    return np.stack([padded[1:-1, 1:-1], weight * horizontal, weight * vertical])


def packed_features(luma: Luma) -> NDArray[np.uint64]:
    """Return the same in half luma levels, above the least there can be, in one word (H, W)."""
    level, horizontal, vertical = (
        np.round(2.0 * feature).astype(np.int64) for feature in luma_features(luma)
    )
    least = round(-255 * GRADIENT_WEIGHT)
    parts = level, horizontal - least, vertical - least
    words = [part.astype(np.uint64) << np.uint64(k * _kernels.LANE) for k, part in enumerate(parts)]
    packed: NDArray[np.uint64] = words[0] | words[1] | words[2]
    return packed


def _limits() -> NDArray[np.float32]:
    return np.array([LEVEL_LIMIT, GRADIENT_LIMIT, GRADIENT_LIMIT], np.float32)


def _box(cost: Costs) -> Costs:
    """Mean over 3x3 pixels."""
    mean = np.empty_like(cost)
    _kernels.box_mean(cost, mean)
    return mean


class VirtualView(NamedTuple):
    """A view without a picture, and two pictures that show its scene."""

    features: tuple[NDArray[np.float32], NDArray[np.float32]]  # `luma_features` of the pictures
    warps: tuple[Floats, Floats]  # from the view to each of them
    block_px: int  # side of the view's blocks


def block_costs(view: VirtualView, hypotheses: DepthHypotheses, spacing_px: float) -> Costs:
    """Compare two pictures along the epipolar lines through each block of a virtual view."""
    height, width = view.features[0].shape[1:]
    cost = np.empty(
        (-(-height // view.block_px), -(-width // view.block_px), hypotheses.num_hypotheses), np.int16
    )
    _kernels.block_cost(
        _kernels.PicturePair(*view.features, *view.warps),
        _kernels.Hypotheses(hypotheses.lowest, hypotheses.step),
        view.block_px,
        spacing_px,
        _limits(),
        OUTSIDE_COST,
        cost,
    )
    return cost


def refine_blocks(view: VirtualView, depth: Floats, reach: float, window_radius_px: int) -> Floats:
    """Refine the depths of the blocks of a virtual view by golden sections."""
    refined = depth.copy()
    (first, *_), (second, *_) = view.features
    pair, search = _kernels.PicturePair(first, second, *view.warps), (MIN_PARALLAX_PX, GOLDEN_STEPS, refined)
    _kernels.golden_search(pair, view.block_px, window_radius_px, reach, *search)
    return refined
