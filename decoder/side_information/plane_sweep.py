"""Dense inverse depth of one key frame by sweeping planes through another: semi-global matching.

For every pixel and every label (a plane of constant inverse depth) the levels and gradients of the two key
frames are compared where the transfer puts the point; eight directions of paths favour surfaces without
jumps, and a parabola refines the best label.

References
----------
[Hirschmuller2008] H. Hirschmuller, "Stereo processing by semiglobal matching and mutual information", IEEE
Trans. Pattern Anal. Mach. Intell. 30(2), 2008.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels_3d
from decoder.side_information.trifocal import transfer_depths

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

MAX_CELLS = 48_000_000
"""Pixels times labels of a cost volume: what memory it may take."""
DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))


@dataclass(frozen=True)
class SweepSettings:
    """How the planes are swept.

    Attributes
    ----------
    label_step_px : float
        Parallax between neighbouring labels where it is largest, apart from the last twentieth.
    max_labels : int
        Most labels.
    level_limit, gradient_limit : float
        Truncation of differences of levels, and of gradients, in luma levels.
    gradient_weight : float
        Weight of the gradients.
    unseen_cost : int
        Cost of a point outside the other frame.
    prior_weight, prior_limit : float
        Cost of a label's distance from an expected depth, per label, and its truncation.
    small_jump, large_jump : int
        Cost of a change of depth by one label, and of a larger one across equal levels.
    """

    label_step_px: float = 0.6
    max_labels: int = 160
    level_limit: float = 30.0
    gradient_limit: float = 60.0
    gradient_weight: float = 3.0
    unseen_cost: int = 30
    prior_weight: float = 8.0
    prior_limit: float = 24.0
    small_jump: int = 8
    large_jump: int = 100


class DepthMap(NamedTuple):
    """Depth of a view.

    Attributes
    ----------
    inverse_depth : ndarray of shape (H, W), float64
        Inverse depth of every pixel.
    reliable : ndarray of shape (H, W), bool
        Where it is certain: two frames agree on it.
    """

    inverse_depth: Floats
    reliable: NDArray[np.bool_]


class LabelRange(NamedTuple):
    """Inverse depths that labels stand for: ``lowest + label * step``.

    Attributes
    ----------
    lowest, step : float
        Inverse depth of the first label, and between labels.
    num_labels : int
        Number of labels, at least 2.
    """

    lowest: float
    step: float
    num_labels: int


def label_range(
    inverse_depth: Floats, transfer: Floats, shape: tuple[int, int], settings: SweepSettings
) -> LabelRange:
    """Choose the labels from the inverse depths of the known points.

    Parameters
    ----------
    inverse_depth : ndarray of shape (N,), float64
        Of the correspondences, in the view that is swept; values that are not finite are left out.
    transfer : ndarray of shape (3, 4), float64
        To the other view.
    shape : tuple of int
        Height and width.
    settings : SweepSettings
        Step and number of labels.

    Returns
    -------
    LabelRange
        Labels that cover nearly all points with a margin.
    """
    known = inverse_depth[np.isfinite(inverse_depth)]
    lowest, highest = np.quantile(known, [0.005, 0.995]) if known.size else (0.0, 0.0)
    span = max(highest - lowest, 1e-6 * max(abs(lowest), abs(highest), 1e-3))
    lowest, highest = lowest - 0.1 * span, highest + 0.2 * span
    height, width = shape
    x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
    points = np.column_stack([x.ravel(), y.ravel()])
    far, near = (transfer_depths(transfer, points, np.full(81, rho)) for rho in (lowest, highest))
    both = (far.status == 0) & (near.status == 0)
    parallax = np.hypot(*(near.points - far.points)[both].T) if both.any() else np.zeros(1)
    wanted = float(np.quantile(np.minimum(parallax, max(shape)), 0.95)) / settings.label_step_px
    most = min(settings.max_labels, MAX_CELLS // (height * width))
    count = int(np.clip(np.ceil(wanted) + 1, 4, max(most, 4)))
    return LabelRange(float(lowest), float((highest - lowest) / (count - 1)), count)


def sweep(
    base: Luma,
    other: Luma,
    transfer: Floats,
    labels: LabelRange,
    settings: SweepSettings,
    prior: DepthMap | None = None,
) -> tuple[Floats, Floats]:
    """Find the inverse depth of every pixel of a frame.

    Parameters
    ----------
    base, other : ndarray of shape (H, W), uint8
        The frame that is swept, and the one that it is compared with.
    transfer : ndarray of shape (3, 4), float64
        From the first to the second.
    labels : LabelRange
        Inverse depths to try.
    settings : SweepSettings
        Costs.
    prior : DepthMap, optional
        What is known of the depth already.

    Returns
    -------
    inverse_depth : ndarray of shape (H, W), float64
        Best inverse depth.
    certainty : ndarray of shape (H, W), float64
        By how much the best label beats all that are not its neighbours.
    """
    limits = np.array([settings.level_limit, settings.gradient_limit, settings.gradient_limit], np.float32)
    cost = np.empty((*base.shape, labels.num_labels), np.int16)
    features = (luma_features(base, settings.gradient_weight), luma_features(other, settings.gradient_weight))
    _kernels_3d.matching_cost(
        *features, transfer, labels.lowest, labels.step, limits, settings.unseen_cost, cost
    )
    cost = _box(cost)
    if prior is not None:
        weights = settings.prior_weight, settings.prior_limit
        _kernels_3d.add_prior(prior.inverse_depth, prior.reliable, labels.lowest, labels.step, *weights, cost)
    label, certainty = choose_labels(cost, base, settings)
    return labels.lowest + labels.step * label, certainty


def choose_labels(cost: NDArray[np.int16], guide: Luma, settings: SweepSettings) -> tuple[Floats, Floats]:
    """Choose labels with small cost and few jumps, by semi-global matching.

    Parameters
    ----------
    cost : ndarray of shape (rows, columns, labels), int16
        Cost of each label, at most a few hundred.
    guide : ndarray of shape (rows, columns), uint8
        Image across whose edges jumps are cheap.
    settings : SweepSettings
        Cost of jumps.

    Returns
    -------
    label : ndarray of shape (rows, columns), float64
        Best label, refined between its neighbours.
    certainty : ndarray of shape (rows, columns), float64
        By how much it beats all that are not its neighbours.
    """
    columns, count = cost.shape[1:]
    total = np.zeros(cost.shape, np.int16)
    levels = guide.astype(np.float32)
    for dy, dx in DIRECTIONS:
        lines = np.full((2, columns, count + 3), 20000, np.int16)
        _kernels_3d.aggregate_path(
            cost, levels, dy, dx, settings.small_jump, settings.large_jump, lines[0], lines[1], total
        )
    label, certainty = np.empty(cost.shape[:2]), np.empty(cost.shape[:2])
    _kernels_3d.best_label(total, label, certainty)
    return label, certainty


def luma_features(luma: Luma, gradient_weight: float) -> NDArray[np.float32]:
    """Return what is compared of a frame.

    Parameters
    ----------
    luma : ndarray of shape (H, W), uint8
        The frame.
    gradient_weight : float
        Factor of the gradients.

    Returns
    -------
    ndarray of shape (3, H, W), float32
        Level, and weighted horizontal and vertical central difference.
    """
    padded = np.pad(luma.astype(np.float32), 1, mode="edge")
    horizontal = padded[1:-1, 2:] - padded[1:-1, :-2]
    vertical = padded[2:, 1:-1] - padded[:-2, 1:-1]
    weight = np.float32(0.5 * gradient_weight)
    return np.stack([padded[1:-1, 1:-1], weight * horizontal, weight * vertical])


def _box(cost: NDArray[np.int16]) -> NDArray[np.int16]:
    """Mean over 3x3 pixels."""
    padded = np.pad(cost, ((1, 1), (0, 0), (0, 0)), mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    padded = np.pad(rows, ((0, 0), (1, 1), (0, 0)), mode="edge")
    total: NDArray[np.int16] = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return total // np.int16(9)
