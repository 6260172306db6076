"""The range of disparities, from matches of views wherever they are in the lattice."""

from typing import cast

import numpy as np

from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.camera_estimation import Features
from dvc.stereo.rectification.rectified_array import (
    RowMatches,
    range_of,
    range_of_matches,
    row_matches,
    suggested_labels,
)


class Seen:
    """Points of one view whose disparities are known; the last one is matched wrongly in all others."""

    def __init__(self, position: LatticePosition, disparities: np.ndarray) -> None:
        self.position, self.disparities, self.partners = position, disparities, list[LatticePosition]()

    def points(self) -> np.ndarray:
        """Return where the points are (2.5)."""
        rows = np.linspace(100.0, 200.0, len(self.disparities))
        moved = np.outer(self.disparities, [self.position.m, self.position.n])
        return np.stack([2.0 * rows, rows], axis=1) - moved

    def match(self, other: "Seen") -> tuple[np.ndarray, np.ndarray]:
        """Return the same points in both views."""
        self.partners.append(other.position)
        here, there = self.points(), other.points()
        apart = np.subtract(other.position, self.position)
        there[-1] += 3.0 * np.array([-apart[1], apart[0]]) / np.hypot(*apart)
        return here, there


def test_reference_is_matched_with_its_neighbours() -> None:
    """The view nearest to the origin with the eight next to it; matches across the parallax are left out."""
    positions = [LatticePosition(m, n) for m in (14.0, 11.0, 12.0, 13.0) for n in (-3.0, -2.0, -1.0, -4.0)]
    disparities = np.array([0.5, 2.0, 7.0, 4.0, 30.0])
    seen = [Seen(position, disparities) for position in positions]
    found = row_matches(positions, cast(list[Features], seen))
    reference = seen[positions.index(LatticePosition(11.0, -1.0))]
    assert [bool(one.partners) for one in seen] == [one is reference for one in seen]
    distances = np.sort([np.hypot(*np.subtract(one, reference.position)) for one in positions])
    chosen = [np.hypot(*np.subtract(one, reference.position)) for one in reference.partners]
    np.testing.assert_allclose(chosen, distances[1:9])
    np.testing.assert_allclose(found.disparities, np.tile(disparities[:-1], 8))
    np.testing.assert_allclose(found.residuals_px, 0.0, atol=1e-9)
    assert range_of_matches(found) is not None


def test_few_matches_give_no_range() -> None:
    """One fewer than twenty are not enough."""
    values = np.linspace(1.0, 9.0, 20)
    assert range_of_matches(RowMatches(values, np.zeros(20))) is not None
    assert range_of_matches(RowMatches(values[1:], np.zeros(19))) is None
    assert RowMatches(values, np.array([3.0, -4.0])).rms_px == np.sqrt(12.5)
    assert RowMatches(values[:0], np.zeros(0)).rms_px is None


def test_wrong_matches_hardly_widen_the_range() -> None:
    """Three in a hundred are far off on each side: at most three times as wide."""
    true = np.linspace(20.0, 60.0, 188)
    wrong = np.concatenate([np.full(6, -3000.0), np.full(6, 5000.0)])
    np.testing.assert_allclose(range_of(true), (20.4, 59.6), atol=0.05)
    lowest, highest = range_of(np.concatenate([true, wrong]))
    assert -20.0 < lowest <= 20.4
    assert 59.6 <= highest < 100.0
    labels = suggested_labels(*range_of(true))
    assert 10.0 < labels.lowest < 15.0
    assert 70.0 < labels.highest < 77.0
    assert labels.step == 1.0
