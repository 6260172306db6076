"""Range of disparities of rectified views, from their matches."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dvc.array_files import MAX_LABELS
from dvc.arrays import Floats
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.camera_estimation import Features
from dvc.stereo.surfaces.occupancy import neighbours

ROW_TOLERANCE_PX = 2.0
"""Largest distance of correct matches from positions that (2.5) allows."""
QUANTILES, INNER_QUANTILES = (0.01, 0.99), (0.05, 0.95)
"""Quantiles of the range, and inner ones that limit it: their distance bounds that to the former."""
FAR_MARGIN, NEAR_MARGIN, MARGIN_PX = 0.15, 0.35, 1.0
"""Margins of the range of known disparities, as shares of it and in pixels; near points are rare."""
MIN_MATCHES = 20
MIN_LABELS = 16
MAX_OUTSIDE = 0.9
"""Share of matches outside a range of disparities that proves it wrong."""
_MAX_PARTNERS = 8


@dataclass(frozen=True, eq=False)
class RowMatches:
    """Matches of the reference view with other views."""

    disparities: Floats  # disparities of matches that agree with (2.5), in pixels per unit of m
    residuals_px: Floats  # distances from (2.5) across the direction of parallax

    @property
    def rms_px(self) -> float | None:
        """Root of the mean squared residual; None without matches."""
        return float(np.sqrt((self.residuals_px**2).mean())) if self.residuals_px.size else None


def range_of_matches(matches: RowMatches) -> tuple[float, float] | None:
    """Return the range of the disparities of matches."""
    return range_of(matches.disparities) if len(matches.disparities) >= MIN_MATCHES else None


def labels_of_matches(array: CameraArray) -> DisparityLabels | None:
    """Return the disparities to try for rectified views, from their matches."""
    positions, features = [view.position for view in array], [Features(view.image) for view in array]
    limits = range_of_matches(row_matches(positions, features))
    return None if limits is None else suggested_labels(*limits)


def check_disparities(array: CameraArray, labels: DisparityLabels, jobs: int = 1) -> None:
    """Compare disparities to try with matches of the reference view and its neighbours."""
    reference = array.reference
    near = neighbours(array, reference).all
    with ThreadPoolExecutor(jobs) as pool:
        features, *neighbour_features = pool.map(
            Features, [array[index].image for index in (reference, *near)]
        )
    for index, other in zip(near, neighbour_features, strict=True):
        pair = array[reference], array[index]
        origin, target = (view.position for view in pair)
        baseline = LatticePosition(target.m - origin.m, target.n - origin.n)
        disparities = row_matches([LatticePosition(0.0, 0.0), baseline], [features, other]).disparities
        slack = MARGIN_PX / float(np.hypot(*baseline))
        outside = (disparities < labels.lowest - slack) | (disparities > labels.highest + slack)
        if len(disparities) < MIN_MATCHES or outside.mean() < MAX_OUTSIDE:
            continue
        low, high = range_of(disparities)
        raise ConfigError(
            f"matches of {pair[0].name} and {pair[1].name} have disparities from {low:.3g} to "
            f"{high:.3g} px, not {labels.lowest:g} to {labels.highest:g}: the range, the order "
            "or the positions of the views are wrong"
        )


def range_of(disparities: Floats) -> tuple[float, float]:
    """Return the range of known disparities without outliers."""
    lowest, low, high, highest = np.quantile(disparities, sorted(QUANTILES + INNER_QUANTILES))
    return float(max(lowest, 2.0 * low - high)), float(min(highest, 2.0 * high - low))


def suggested_labels(lowest: float, highest: float) -> DisparityLabels:
    """Return disparities to try around a range of known ones."""
    low = lowest - FAR_MARGIN * (highest - lowest) - MARGIN_PX
    high = highest + NEAR_MARGIN * (highest - lowest) + MARGIN_PX
    step = min(1.0, 2.0 ** math.floor(math.log2((high - low) / MIN_LABELS)))
    step = max(step, 2.0 ** math.ceil(math.log2((high - low) / (MAX_LABELS - 2))))
    first, last = math.floor(low / step), math.ceil(high / step)
    return DisparityLabels(first * step, step, last - first + 1)


def row_matches(
    positions: Sequence[LatticePosition],
    features: Sequence[Features],
    rectified: Callable[[int, Floats], Floats] = lambda _, points: points,
) -> RowMatches:
    """Match the reference view with the views nearest to it."""
    centres = np.array(positions)
    distance = np.linalg.norm(centres, axis=1)
    reference = int(distance.argmin())
    nearest = np.argsort(np.linalg.norm(centres - centres[reference], axis=1), kind="stable")
    disparities, residuals = [np.zeros(0)], [np.zeros(0)]
    for index in nearest[1 : 1 + _MAX_PARTNERS]:
        here, there = features[reference].match(features[index])
        moved = rectified(reference, here) - rectified(int(index), there)
        baseline = centres[index] - centres[reference]
        unit = baseline / np.linalg.norm(baseline)
        across = moved @ np.array([-unit[1], unit[0]])
        close = np.abs(across) <= ROW_TOLERANCE_PX
        disparities.append((moved @ unit / np.linalg.norm(baseline))[close])
        residuals.append(across[close])
    return RowMatches(np.concatenate(disparities), np.concatenate(residuals))
