"""The range of disparities of rectified views, from points that they share."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.feature_matching import Features
from dvc.stereo.surfaces.occupancy import neighbours

Floats = NDArray[np.float64]

ROW_TOLERANCE_PX = 2.0
"""Matches farther than this from where (2.5) allows them are wrong."""
QUANTILES, INNER_QUANTILES = (0.01, 0.99), (0.05, 0.95)
"""The former, but not farther from the latter than these are from each other: a few matches are wrong."""
FAR_MARGIN, NEAR_MARGIN, MARGIN_PX = 0.15, 0.35, 1.0
"""Added to the range of known disparities: in parts of it, and in pixels. The nearest points are few."""
MIN_MATCHES = 20
MIN_LABELS = 16
MOST_OUTSIDE = 0.9
"""Share of matches outside a range of disparities that shows it to be wrong."""
_MAX_PARTNERS = 8


@dataclass(frozen=True, eq=False)
class RowMatches:
    """Points that the reference view and others share."""

    disparities: Floats  # of matches that agree with (2.5), in pixels per unit of m
    residuals_px: Floats  # how far across the direction of parallax they lie from where (2.5) has them

    @property
    def rms_px(self) -> float | None:
        """Root of the mean squared residual; None without matches."""
        return float(np.sqrt((self.residuals_px**2).mean())) if self.residuals_px.size else None


def range_of_matches(matches: RowMatches) -> tuple[float, float] | None:
    """Return the range of the disparities of matches."""
    return range_of(matches.disparities) if len(matches.disparities) >= MIN_MATCHES else None


def found_labels(array: CameraArray) -> DisparityLabels | None:
    """Return the disparities to try for views that are rectified already, from points that they share."""
    positions, features = [view.position for view in array], [Features(view.image) for view in array]
    found = range_of_matches(row_matches(positions, features))
    return None if found is None else suggested_labels(*found)


def check_disparities(array: CameraArray, labels: DisparityLabels, jobs: int = 1) -> None:
    """Compare disparities to try with those of points that the reference view and its neighbours share."""
    reference = array.reference
    near = neighbours(array, reference).all
    with ThreadPoolExecutor(jobs) as pool:
        own, *others = pool.map(Features, [array[index].image for index in (reference, *near)])
    for index, other in zip(near, others, strict=True):
        pair = array[reference], array[index]
        origin, place = (view.position for view in pair)
        baseline = LatticePosition(place.m - origin.m, place.n - origin.n)
        found = row_matches([LatticePosition(0.0, 0.0), baseline], [own, other]).disparities
        slack = MARGIN_PX / float(np.hypot(*baseline))
        outside = (found < labels.lowest - slack) | (found > labels.highest + slack)
        if len(found) < MIN_MATCHES or outside.mean() < MOST_OUTSIDE:
            continue
        low, high = range_of(found)
        raise ConfigError(
            f"points that {pair[0].name} and {pair[1].name} share have disparities from {low:.3g} to "
            f"{high:.3g} px, not {labels.lowest:g} to {labels.highest:g}: the range, or the order or the "
            "positions of the views are wrong"
        )


def range_of(disparities: Floats) -> tuple[float, float]:
    """Return the range of known disparities."""
    lowest, low, high, highest = np.quantile(disparities, sorted(QUANTILES + INNER_QUANTILES))
    return float(max(lowest, 2.0 * low - high)), float(min(highest, 2.0 * high - low))


def suggested_labels(lowest: float, highest: float) -> DisparityLabels:
    """Return disparities to try where those of some points are known."""
    low = lowest - FAR_MARGIN * (highest - lowest) - MARGIN_PX
    high = highest + NEAR_MARGIN * (highest - lowest) + MARGIN_PX
    step = min(1.0, 2.0 ** math.floor(math.log2((high - low) / MIN_LABELS)))
    step = max(step, 2.0 ** math.ceil(math.log2((high - low) / (MAX_LABELS - 2))))
    first, last = math.floor(low / step), math.ceil(high / step)
    return DisparityLabels(first * step, step, last - first + 1)


def row_matches(
    positions: Sequence[LatticePosition],
    features: Sequence[Features],
    placed: Callable[[int, Floats], Floats] = lambda _, points: points,
) -> RowMatches:
    """Match the reference view with those nearest to it."""
    places = np.array(positions)
    distance = np.linalg.norm(places, axis=1)
    reference = int(distance.argmin())
    nearest = np.argsort(np.linalg.norm(places - places[reference], axis=1), kind="stable")
    disparities, residuals = [np.zeros(0)], [np.zeros(0)]
    for index in nearest[1 : 1 + _MAX_PARTNERS]:
        here, there = features[reference].match(features[index])
        moved = placed(reference, here) - placed(int(index), there)
        baseline = places[index] - places[reference]
        unit = baseline / np.linalg.norm(baseline)
        across = moved @ np.array([-unit[1], unit[0]])
        kept = np.abs(across) <= ROW_TOLERANCE_PX
        disparities.append((moved @ unit / np.linalg.norm(baseline))[kept])
        residuals.append(across[kept])
    return RowMatches(np.concatenate(disparities), np.concatenate(residuals))
