"""Corner detector: signs, exactness, both precisions, spacing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc._jit import python_twin
from dvc.corners import _take_spaced, corner_response, is_local_max, quick_corner_response, spaced
from tests.clips import moving_texture

BOX, BINOMIAL = np.ones(5), [1, 2, 1]


@pytest.mark.parametrize("window", [BOX, BINOMIAL])
def test_response_is_negative_on_edges_and_positive_at_corners(window: list[int]) -> None:
    luma = np.zeros((40, 40), dtype=np.uint8)
    luma[20:, 20:] = 100
    response = corner_response(luma, window)
    assert response[20, 20] > 0
    assert response[32, 20] < 0
    assert response[5, 5] == 0


@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (37, 53)])
def test_response_is_exact(shape: tuple[int, int]) -> None:
    luma = np.random.default_rng(3).integers(0, 256, shape).astype(np.uint8)
    taps, smooth, slope = [1, 4, 6, 4, 1], [1, 2, 1], [-1, 0, 1]

    def filtered(values: np.ndarray, down: list[int], across: list[int]) -> np.ndarray:
        for axis, weights in ((0, down), (1, across)):
            reach = len(weights) // 2
            width = [(reach, reach) if axis == k else (0, 0) for k in range(2)]
            if values.shape[axis] > 1:
                padded = np.pad(values, width, mode="reflect")
            else:
                padded = np.pad(values, width, mode="edge")
            parts = [np.take(padded, range(k, k + values.shape[axis]), axis) for k in range(len(weights))]
            values = sum(weight * part for weight, part in zip(weights, parts, strict=True))
        return values

    dx, dy = filtered(luma.astype(int), smooth, slope), filtered(luma.astype(int), slope, smooth)
    xx, xy, yy = (filtered(product, taps, taps) for product in (dx * dx, dx * dy, dy * dy))
    expected = (xx * yy - xy * xy) - 0.04 * (xx + yy).astype(float) ** 2
    np.testing.assert_allclose(corner_response(luma, taps), expected, rtol=1e-12)


@pytest.mark.parametrize("window_px", [3, 5])
def test_the_quick_response_is_the_same(window_px: int) -> None:
    """Single precision agrees up to its scale: what the encoder finds, the decoder looks for."""
    luma = moving_texture(1, 120, 160)[0].luma
    exact = corner_response(luma, np.ones(window_px)) / (4 * 255.0 * window_px) ** 4
    np.testing.assert_allclose(
        quick_corner_response(luma, window_px), exact, rtol=1e-4, atol=1e-6 * exact.max()
    )


@pytest.mark.parametrize("radius_px", [1, 3])
def test_local_maxima_agree_with_the_twin(radius_px: int) -> None:
    values = np.random.default_rng(2).integers(0, 30, (20, 27)).astype(np.float64)
    padded = np.pad(values, radius_px, constant_values=-1)
    squares = np.lib.stride_tricks.sliding_window_view(padded, (2 * radius_px + 1, 2 * radius_px + 1))
    np.testing.assert_array_equal(is_local_max(values, radius_px), squares.max(axis=(2, 3)) == values)


@pytest.mark.nojit
@given(
    st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20)), max_size=40),
    st.integers(0, 9),
    st.floats(0, 9),
)
def test_spacing_agrees_with_the_twin(
    points: list[tuple[int, int]], max_points: int, distance: float
) -> None:
    """A point is taken unless one taken before is nearer than the distance, or there are enough."""
    expected: list[int] = []
    for i, (x, y) in enumerate(points):
        clear = all((points[j][0] - x) ** 2 + (points[j][1] - y) ** 2 >= distance**2 for j in expected)
        if clear and len(expected) < max_points:
            expected.append(i)
    array = np.array(points, np.int64).reshape(-1, 2)
    assert spaced(array, max_points, distance).tolist() == expected
    taken = np.empty(max_points, np.int64)
    count = python_twin(_take_spaced)(array.astype(np.float64), distance**2, taken)
    assert taken[:count].tolist() == expected
