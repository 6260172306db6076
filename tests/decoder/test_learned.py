"""What planes turn out to cost and to save corrects what is expected of the next."""

import numpy as np
import pytest

from decoder.learned import CLASSES, MAX_WIDTH, STRENGTH_BITS, Learned, LearnedWorth
from dvc.wynerziv.priors import LearnedPriors

MULTIPLIER = 40.0


def test_classes_hold_every_band_once() -> None:
    """In zigzag order."""
    assert [band for bands in CLASSES for band in bands] == list(range(16))


def test_nothing_learned_leaves_expectations_as_they_are() -> None:
    """For all bands and widths."""
    worth = LearnedWorth()
    assert {worth.factors(band, width, MULTIPLIER) for band in range(16) for width in range(12)} == {
        (1.0, 1.0)
    }


def test_factors_go_from_one_to_what_was_seen() -> None:
    """The noise model counts as so many bits beside them, which in the end is nothing."""
    worth = LearnedWorth()
    strength = STRENGTH_BITS * MULTIPLIER
    worth.learn(0, 1, (strength, STRENGTH_BITS), (0.5 * strength, 2.0 * STRENGTH_BITS))
    assert worth.factors(0, 1, MULTIPLIER) == pytest.approx((0.75, 1.5))
    for _ in range(2000):
        worth.learn(0, 1, (strength, STRENGTH_BITS), (0.5 * strength, 2.0 * STRENGTH_BITS))
    assert worth.factors(0, 1, MULTIPLIER) == pytest.approx((0.5, 2.0), rel=1e-3)


@pytest.mark.parametrize(
    ("band", "width", "is_alike"),
    [(1, 2, True), (2, 2, True), (0, 2, False), (3, 2, False), (1, 1, False), (15, 2, False)],
)
def test_bands_of_a_class_learn_together(band: int, width: int, is_alike: bool) -> None:
    """If their bins are equally wide."""
    worth = LearnedWorth()
    worth.learn(1, 2, (100.0, 50.0), (900.0, 10.0))
    assert (worth.factors(band, width, MULTIPLIER) != (1.0, 1.0)) == is_alike


def test_wide_bins_count_as_alike() -> None:
    """From a width on."""
    worth = LearnedWorth()
    worth.learn(0, MAX_WIDTH + 3, (100.0, 50.0), (900.0, 10.0))
    assert worth.factors(0, MAX_WIDTH, 1.0) == worth.factors(0, MAX_WIDTH + 1, 1.0) != (1.0, 1.0)


def test_frames_side_by_side_add_up() -> None:
    """Each learns from a copy; together they know what one after the other would, in any order."""
    together = Learned(LearnedPriors((4, 4)))
    together.worth.learn(0, 0, (10.0, 5.0), (20.0, 6.0))
    before = together.worth.sums.copy()
    several = [together.copy() for _ in range(3)]
    for number, own in enumerate(several, 1):
        own.worth.learn(0, number, (10.0 * number, 1.0), (1.0, 1.0))
    np.testing.assert_array_equal(together.worth.sums, before)
    joined, expected = together.joined(several), together.copy()
    for number in (3, 1, 2):
        expected.worth.learn(0, number, (10.0 * number, 1.0), (1.0, 1.0))
    np.testing.assert_array_equal(joined.worth.sums, expected.worth.sums)
