"""The conditional mean against quadrature, and its special cases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv.reconstruction import conditional_mean
from tests.reference import wynerziv_noise as reference


def mean_of(lower: float, upper: float, side_information: float, scale: float) -> float:
    arguments = (np.array([value]) for value in (lower, upper, side_information, scale))
    return float(conditional_mean(*arguments)[0])


@given(st.floats(-200, 200), st.floats(0.01, 300), st.floats(-500, 500), st.floats(0.3, 100))
def test_equals_quadrature(lower: float, width: float, side_information: float, scale: float) -> None:
    """The closed form is the mean of the Laplacian over the bin, wherever the side information lies."""
    expected = reference.conditional_mean(lower, lower + width, side_information, scale)
    tolerance = 1e-6 * width + 1e-7 * scale
    assert mean_of(lower, lower + width, side_information, scale) == pytest.approx(expected, abs=tolerance)


@given(st.floats(-1e4, 1e4), st.floats(0, 1e4), st.floats(-1e4, 1e4), st.floats(1e-3, 1e4))
def test_stays_in_the_bin(lower: float, width: float, side_information: float, scale: float) -> None:
    """Whatever the numbers, the reconstruction lies within the borders."""
    assert lower <= mean_of(lower, lower + width, side_information, scale) <= lower + width


def test_side_information_in_the_middle_is_kept() -> None:
    """By symmetry the middle of the bin stays where it is."""
    assert mean_of(-4.0, 4.0, 0.0, 3.0) == 0.0


def test_side_information_outside_leads_to_the_closer_border() -> None:
    """From afar only the border counts: the mean is one scale inside it, for a bin much wider than that."""
    assert mean_of(0.0, 100.0, -50.0, 2.0) == pytest.approx(2.0)
    assert mean_of(0.0, 100.0, 150.0, 2.0) == pytest.approx(98.0)
    assert mean_of(0.0, 100.0, -1e9, 2.0) == pytest.approx(2.0)


def test_unreliable_side_information_leaves_the_middle() -> None:
    """A very large scale makes the density flat over the bin."""
    assert mean_of(0.0, 10.0, 1.0, 1e6) == pytest.approx(5.0, abs=1e-3)


def test_reliable_side_information_is_taken() -> None:
    """A very small scale keeps side information that lies in the bin."""
    assert mean_of(0.0, 10.0, 3.0, 1e-3) == pytest.approx(3.0)


def test_empty_bins_give_their_border() -> None:
    """A bin without width has one value."""
    assert mean_of(12.0, 12.0, 3.0, 1.0) == 12.0
