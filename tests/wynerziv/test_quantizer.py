"""Scalar quantisers and bit planes: borders, bins, digits."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv import _kernels, quantizer, transform
from dvc.wynerziv.noise import GAINS, GAINS_PER_OCTAVE
from dvc.wynerziv.quantizer import LENGTHS, length_code
from tests.reference import wynerziv as reference
from tests.twins import Choose

levels_strategy = st.sampled_from([2, 4, 8, 16, 32, 64, 128, 256])


def test_dc_bins_are_uniform() -> None:
    """DC has as many bins as levels, equally wide, from 0 to 1024."""
    edges = quantizer.bin_edges(8, None)
    np.testing.assert_array_equal(edges, np.arange(9) * 128.0)


def test_ac_bins_have_a_doubled_zero_bin() -> None:
    """AC has one bin fewer than levels; the middle one is twice as wide, and all are symmetric about zero."""
    np.testing.assert_array_equal(quantizer.bin_edges(8, 3.0), [-12, -9, -6, -3, 3, 6, 9, 12])
    np.testing.assert_array_equal(quantizer.bin_edges(2, 5.0), [-5, 5])


@given(levels_strategy, st.lists(st.floats(-1020.0, 1020.0), max_size=20))
def test_step_holds_every_coefficient(levels: int, values: list[float]) -> None:
    """The step that is sent makes the bins hold the largest magnitude, with half a step to spare."""
    coefficients = np.array(values, dtype=np.float64)
    index = quantizer.step_index(coefficients, levels)
    assert 0 <= index < 2**quantizer.STEP_INDEX_BITS
    reach = quantizer.STEPS[index] * levels / 2
    largest = np.abs(coefficients).max(initial=0.0)
    assert largest <= reach * (1 + 1e-9)
    smaller = quantizer.STEPS[index - 1] * (levels - 1) / 2
    assert index == 0 or largest > smaller * (1 - 1e-6)


@given(st.integers(0, 15), st.integers(0, 63), st.lists(st.integers(-4080, 4080), min_size=1, max_size=20))
def test_embedded_bins_hold_every_coefficient(band: int, index: int, values: list[int]) -> None:
    core = np.abs(values) if band == 0 else np.array(values)
    step, coefficients = quantizer.STEPS[index], core * transform.BAND_SCALE[band]
    extremes = np.zeros((16, 2), np.int16)
    extremes[band] = core.min(), core.max()
    planes = int(quantizer.embedded_planes(extremes, step)[band])
    edges = quantizer.embedded_edges(band, planes, step)
    assert edges.shape == (2**planes + 1,)
    assert edges[0] * (1 + 1e-9) <= coefficients.min()
    assert coefficients.max() <= edges[-1] * (1 + 1e-9)
    if planes:
        fewer = quantizer.embedded_edges(band, planes - 1, step)
        assert coefficients.min() < fewer[0] or coefficients.max() >= fewer[-1]


@pytest.mark.nojit
def test_planes_are_counted_like_their_twin(choose: Choose) -> None:
    """Compiled and as Python, the kernel finds the fewest planes, on borders and beyond the largest."""
    rng = np.random.default_rng(3)
    origins = np.array(
        [[quantizer.embedded_origin(band, count) for count in range(13)] for band in range(16)]
    )
    run = choose(_kernels.count_planes)
    planes = np.empty(16, np.int64)
    for step in (1.0, 1.1, 37.0):
        for _ in range(40):
            ends = (
                rng.choice(origins.ravel(), (16, 2)) * step * rng.choice([0.0, 0.5, 1.0, 1.0, 3.0], (16, 2))
            )
            extremes = ends * [-1.0, 1.0]
            run(extremes, np.ones(16), origins, step, planes)
            expected = [reference.embedded_planes(band, *extremes[band].tolist(), step) for band in range(16)]
            assert planes.tolist() == expected


@given(st.lists(st.integers(0, 12), min_size=16, max_size=16))
def test_origins_of_all_bands_are_those_of_each(planes: list[int]) -> None:
    expected = [quantizer.embedded_origin(band, count) for band, count in enumerate(planes)]
    assert quantizer.ORIGINS[np.arange(16), planes].tolist() == expected


@given(st.integers(0, 15), st.integers(1, 12))
def test_embedded_bins_halve_those_of_fewer_planes(band: int, planes: int) -> None:
    """A plane more at the top adds bins around the same ones; one at the bottom halves each of them."""
    edges = quantizer.embedded_edges(band, planes, 1.0)
    wider = quantizer.embedded_edges(band, planes + 1, 1.0)
    above = np.searchsorted(wider, edges).clip(1, wider.size - 1)
    assert np.minimum(np.abs(wider[above - 1] - edges), np.abs(wider[above] - edges)).max() < 1e-9
    joined = edges[:: 2 if planes > 1 else 1]
    assert np.isin(np.round(joined, 9), np.round(edges, 9)).all()


@given(st.integers(1, 15), st.integers(0, 12), st.integers(0, 12))
def test_zero_is_a_third_into_its_bin_at_every_depth(band: int, planes: int, missing: int) -> None:
    missing = min(missing, planes)
    edges = quantizer.embedded_edges(band, planes, 1.0)[:: 2**missing]
    bin_number = np.searchsorted(edges, 0.0) - 1
    share = -edges[bin_number] / 2**missing
    assert min(abs(share - 1 / 3), abs(share - 2 / 3)) < 1e-9


@given(levels_strategy, st.integers(0, 2**32 - 1))
def test_prefix_borders_close_in_on_the_bin(levels: int, seed: int) -> None:
    """Every further plane narrows the interval, which holds the coefficient to the last."""
    coefficients = np.random.default_rng(seed).uniform(-60.0, 60.0, 30)
    edges = quantizer.bin_edges(levels, 60.0 * 2 / levels)
    bins = reference.quantize(coefficients, edges)
    count = levels.bit_length() - 1
    planes = reference.to_planes(bins, count)
    widths = [np.full(30, np.inf)]
    for known in range(count + 1):
        prefix = reference.from_planes(planes[:known])
        lower, upper = quantizer.prefix_borders(prefix, count - known, edges)
        assert (lower <= coefficients).all()
        assert (coefficients <= upper).all()
        assert (upper - lower <= widths[-1]).all()
        widths.append(upper - lower)
    np.testing.assert_array_equal(lower, edges[bins])
    np.testing.assert_array_equal(upper, edges[bins + 1])


def test_powers_of_two_are_the_nearest_numbers() -> None:
    """By exact arithmetic: what lies half-way to the next numbers is too small and too large."""
    for sixths in range(-30, 70):
        power = quantizer.power_of_two(sixths)
        below, above = (Fraction(math.nextafter(power, end)) for end in (0.0, math.inf))
        least, most = ((Fraction(power) + other) / 2 for other in (below, above))
        assert least**6 <= Fraction(2) ** sixths <= most**6


def test_every_step_has_its_index() -> None:
    for index in range(64):
        step = quantizer.STEPS[index]
        assert quantizer.index_of_step(step) == quantizer.index_of_step(step * (1 + 1e-12)) == index
        assert quantizer.index_of_step(step * (1 - 1e-12)) == index
        assert quantizer.index_of_step(1.001 * step) == min(index + 1, 63)


def test_bins_that_do_not_exist_have_no_width() -> None:
    lower, upper = quantizer.prefix_borders(np.array([7]), 0, quantizer.bin_edges(8, 3.0))
    assert lower[0] == upper[0] == 12.0


def test_gains_are_the_same_with_every_c_library() -> None:
    np.testing.assert_allclose(GAINS, 2.0 ** (np.arange(-6, 16) / GAINS_PER_OCTAVE), rtol=1e-15)
    assert np.array_equal(GAINS[GAINS_PER_OCTAVE:], 2.0 * GAINS[:-GAINS_PER_OCTAVE])


def test_lengths_are_told_on_a_fine_scale() -> None:
    """Every code is longer than the one before, by 1/16 or 16 bits at most."""
    assert LENGTHS[:3] == (0, 16, 17)
    assert all(0 < after - before <= max(before / 16, 16) for before, after in pairwise(LENGTHS))
    for bits in (1, 16, 17, 100.5, 4095, 4097, 100_000):
        code = length_code(bits)
        assert LENGTHS[code - 1] < bits <= LENGTHS[code]
    assert length_code(0) == 0
    assert length_code(1e12) == 255
