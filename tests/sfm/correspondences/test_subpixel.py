"""Sub-pixel refinement on textures that move by known fractions of a pixel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.arrays import Floats
from sfm.correspondences import spline_sampling, subpixel
from sfm.correspondences.point_matching import detect_corners
from sfm.correspondences.spline_sampling import half_pixel_samples, spline, spline_coefficients
from sfm.correspondences.subpixel import refine, window
from tests.reference import sfm_neighbourhoods as reference
from tests.sfm.textures import picture, shifted, texture
from tests.twins import Choose

HEIGHT, WIDTH = 72, 96
TEXTURE = texture(1)
STILL = picture(TEXTURE, HEIGHT, WIDTH)
CORNERS = detect_corners(STILL)
INNER = CORNERS[((CORNERS > 14) & (CORNERS < [WIDTH - 15, HEIGHT - 15])).all(axis=1)]


@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
def test_shifts_are_recovered(x: float, y: float) -> None:
    """Any shift is found within a few hundredths of a pixel, from the nearest whole pixel."""
    moved = shifted(TEXTURE, HEIGHT, WIDTH, (x, y))
    start = INNER + np.rint([x, y])
    second, error, success = refine(STILL, moved, INNER, start)
    assert success.all()
    assert np.abs(second - INNER - [x, y]).max() < 0.04
    assert error.max() < 1.0  # what rounding to whole levels leaves


def test_exposure_does_not_matter() -> None:
    moved = shifted(TEXTURE, HEIGHT, WIDTH, (0.4, -0.3))
    dark = np.clip(moved.astype(np.int64) - 15, 0, 255).astype(np.uint8)
    usual, other = (refine(STILL, image, INNER, INNER)[0] for image in (moved, dark))
    np.testing.assert_allclose(usual, other, atol=1e-6)


def test_affine_maps_are_followed() -> None:
    """At a scale of 1.15 affine neighbourhoods stay within 0.04 px and explain the picture; others do not."""
    centre = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    forward = np.array([[1.15, 0.05], [-0.04, 1.1]])
    inverse = np.linalg.inv(forward)
    source = np.column_stack([inverse, centre - inverse @ centre])
    moved = picture(TEXTURE, HEIGHT, WIDTH, source)
    points = INNER[np.abs(INNER - centre).max(axis=1) < 18]
    expected = (points - centre) @ forward.T + centre
    plain, error_plain, _ = refine(STILL, moved, points, np.rint(expected))
    affine, error, success = refine(STILL, moved, points, np.rint(expected), affine=True)
    assert success.mean() > 0.9
    assert np.abs(affine - expected)[success].max() < 0.04
    assert np.median(error[success]) < 0.02 * np.median(error_plain[np.isfinite(error_plain)])
    shapes = np.tile(forward, (len(points), 1, 1))
    known, _, success = refine(STILL, moved, points, np.rint(expected), affine=True, shapes=shapes)
    assert success.all()
    assert np.abs(known - expected).max() < 0.04
    assert np.abs(plain - expected).max() < 2.0


def test_points_that_cannot_be_refined() -> None:
    """Flat neighbourhoods, points at the edge, and points that run away stay; no points are no error."""
    none = np.empty((0, 2))
    assert [len(each) for each in refine(STILL, STILL, none, none)] == [0, 0, 0]
    flat = np.full((40, 40), 90, dtype=np.uint8)
    first = np.array([[20.0, 20.0], [2.0, 20.0], [20.0, 39.0]])
    second, error, success = refine(flat, flat, first, first)
    assert not success.any()
    assert np.isinf(error).all()
    np.testing.assert_array_equal(second, first)
    far = shifted(TEXTURE, HEIGHT, WIDTH, (3.1, 0.0))
    second, _, success = refine(STILL, far, INNER, INNER)
    np.testing.assert_array_equal(second[~success], INNER[~success])
    assert (np.abs(second - INNER).max(axis=1) <= 2.0).all()
    assert not success.all()


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="one shape"):
        refine(STILL, STILL[1:], INNER, INNER)
    with pytest.raises(ValueError, match="whole pixels"):
        refine(STILL, STILL, INNER + 0.5, INNER)


@pytest.mark.parametrize("shape", [(2, 3), (5, 40), (33, 48), (1, 1)])
def test_splines_interpolate(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(2).uniform(0, 255, shape)
    coefficients = spline_coefficients(image)
    if min(shape) == 1:
        np.testing.assert_array_equal(coefficients, image)
        return
    again = [[reference.interpolated(coefficients, x, y) for x in range(shape[1])] for y in range(shape[0])]
    np.testing.assert_allclose(again, image, atol=1e-9)


def test_samples_half_a_pixel_apart() -> None:
    image = np.random.default_rng(3).uniform(0, 255, (6, 9))
    samples, coefficients = half_pixel_samples(spline(image)), spline_coefficients(image)
    assert samples.shape == (12, 18)
    expected = [[reference.interpolated(coefficients, x / 2, y / 2) for x in range(17)] for y in range(11)]
    np.testing.assert_allclose(samples[:11, :17], expected, atol=1e-9)


def test_weights_of_the_window() -> None:
    weights = window(3)
    assert weights.shape == (7, 7)
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() > 0
    assert weights.argmax() == 24
    np.testing.assert_array_equal(weights, weights[::-1].T)


# ---- kernels ----

COEFFICIENTS, SPLINE = spline_coefficients(STILL), spline(STILL)


@pytest.mark.nojit
@pytest.mark.parametrize("place", [(20.3, 30.8), (3.0, 4.0), (2.2, 69.0), (92.9, 2.0)])
def test_samples_and_gradients(choose: Choose, place: tuple[float, float]) -> None:
    """Values are those of the spline, gradients those of its differences; both samplers agree."""
    values, dx, dy = (np.empty((5, 5)) for _ in range(3))
    choose(spline_sampling.sample_square)(SPLINE, *place, 2, values, dx, dy)
    expected = reference.neighbourhood(COEFFICIENTS, *place, np.eye(2), 2)
    np.testing.assert_allclose(values.ravel(), expected, atol=1e-9)
    step = 1e-5
    for gradient, offset in ((dx, (step, 0.0)), (dy, (0.0, step))):
        moved = [np.array(place) + s * np.array(offset) for s in (1, -1)]
        ends = [reference.neighbourhood(COEFFICIENTS, *at, np.eye(2), 2) for at in moved]
        np.testing.assert_allclose(gradient.ravel(), (ends[0] - ends[1]) / (2 * step), atol=1e-4)
    if min(place) > 3 and place[0] < 90:
        affine = np.array([[0.9, 0.2], [-0.1, 1.1]])
        parameters = np.array([*place, *affine.ravel()])
        choose(spline_sampling.sample_affine)(SPLINE, parameters, 2, values, dx, dy)
        expected = reference.neighbourhood(COEFFICIENTS, *place, affine, 2)
        np.testing.assert_allclose(values.ravel(), expected, atol=1e-9)


@pytest.mark.nojit
@pytest.mark.parametrize("num_parameters", [2, 6])
def test_normal_equations(choose: Choose, num_parameters: int) -> None:
    """Matrix, vector and error are those of least squares with a free constant, and so is the step."""
    rng = np.random.default_rng(7)
    target, values, dx, dy = rng.normal(0, 20, (4, 5, 5))
    weights = window(2)
    matrix, vector = np.empty((num_parameters, num_parameters)), np.empty(num_parameters)
    error = choose(subpixel.normal_equations)(target, values, dx, dy, weights, matrix, vector)
    expected = reference.normal_equations(target, values, dx, dy, weights, num_parameters)
    np.testing.assert_allclose(matrix, expected[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(vector, expected[1], rtol=1e-9, atol=1e-9)
    assert error == pytest.approx(reference.free_mean_error(target, values, weights))
    step = np.empty(num_parameters)
    assert choose(subpixel.solve_damped)(matrix, vector, 0.3, step)
    damped = matrix + 0.3 * np.diag(np.diag(matrix))
    np.testing.assert_allclose(step, np.linalg.solve(damped, -vector), rtol=1e-9)
    for singular in (np.zeros((2, 2)), np.ones((2, 2))):
        assert not choose(subpixel.solve_damped)(singular, np.ones(2), 0.0, np.empty(2))


def test_minimum_is_one() -> None:
    moved = shifted(TEXTURE, HEIGHT, WIDTH, (0.6, 0.2))
    (found,), (error,), _ = refine(STILL, moved, INNER[:1], INNER[:1])
    x, y = INNER[0].astype(int)
    target = STILL[y - 5 : y + 6, x - 5 : x + 6].astype(np.float64)

    def error_at(position: Floats) -> float:
        values = reference.neighbourhood(spline_coefficients(moved), *position, np.eye(2), 5)
        return reference.free_mean_error(target, values, window(5))

    assert error == pytest.approx(error_at(found), abs=1e-6)
    for step in ([0.05, 0.0], [-0.05, 0.0], [0.0, 0.05], [0.0, -0.05]):
        assert error_at(found + step) > error
