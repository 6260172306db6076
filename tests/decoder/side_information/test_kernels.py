"""The compiled block-motion loops against twins that try every candidate in full."""

import numpy as np
import pytest

from decoder.side_information import _kernels
from decoder.side_information.block_motion import MARGIN, phase_planes
from tests.clips import moving_texture
from tests.reference import block_motion as reference
from tests.twins import Choose

pytestmark = pytest.mark.nojit


@pytest.fixture(scope="module")
def planes() -> list[np.ndarray]:
    """Return the phase planes of three frames; the middle of nowhere is worth a search as well."""
    return [phase_planes(frame.luma) for frame in moving_texture(3, 14, 22, (0.75, -1.5))]


@pytest.mark.parametrize("side", [6, 8, 12, 16, 24])
def test_sums_of_absolute_differences(choose: Choose, planes: list[np.ndarray], side: int) -> None:
    a, b = planes[:2]
    expected = reference.difference(a, (133, 146), b, (139, 141), side)
    assert choose(_kernels.block_sad)(a, 133, 146, b, 139, 141, side) == expected
    white = np.full_like(a, 255)
    assert choose(_kernels.block_sad)(white, 0, 3, 255 - white, 2, 1, side) == 255 * side**2


def test_forward_search(choose: Choose, planes: list[np.ndarray]) -> None:
    starts = np.array([[[0, 0], [4, -6], [0, 300]], [[-400, 2], [3, 3], [1, -1]]])
    vectors = np.empty_like(starts)
    settings = (MARGIN, 8, 10, 1, 2, 0.03)
    blocks, steps = _kernels.Blocks(*settings[:3]), _kernels.Steps(*settings[3:])
    pair = planes[0], planes[2]
    choose(_kernels.forward_search)(pair, blocks, steps, starts, vectors)
    np.testing.assert_array_equal(vectors, reference.forward_search(planes[0], planes[2], *settings, starts))


@pytest.mark.parametrize("instant", [(1, 2), (1, 3), (3, 4)])
def test_refine_bilateral(choose: Choose, planes: list[np.ndarray], instant: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    field, medians = rng.integers(-12, 13, (2, 2, 3, 2))
    medians[0, 1], field[1, 2] = (-700, 0), (0, 900)
    vectors = np.empty((2, 3, 2), np.int64)
    settings = (MARGIN, 8, 10, 1, 1, 6, *instant)
    blocks, steps = _kernels.Blocks(*settings[:3]), _kernels.Steps(*settings[3:6])
    pair = planes[0], planes[2]
    choose(_kernels.refine_bilateral)(pair, instant, blocks, steps, (field, medians), vectors)
    candidates = np.concatenate(
        [neighbourhoods(medians), field[:, :, None], np.zeros((2, 3, 1, 2), np.int64)], axis=2
    )
    expected = reference.refine_bilateral(planes[0], planes[2], *settings, candidates)
    np.testing.assert_array_equal(vectors, expected)


def neighbourhoods(field: np.ndarray) -> np.ndarray:
    """Return each vector and its eight neighbours: (rows, columns, 9, 2)."""
    padded = np.pad(field, ((1, 1), (1, 1), (0, 0)), mode="edge")
    shifts = [(1, 1), *(place for place in np.ndindex(3, 3) if place != (1, 1))]
    rows, columns = field.shape[:2]
    return np.stack([padded[y : y + rows, x : x + columns] for y, x in shifts], axis=2)


def test_vector_median(choose: Choose) -> None:
    field = np.random.default_rng(2).integers(-9, 10, (5, 7, 2))
    median = np.empty_like(field)
    choose(_kernels.vector_median)(field, median)
    vectors = neighbourhoods(field)
    distances = np.abs(vectors[:, :, :, None] - vectors[:, :, None]).sum(axis=(-2, -1))
    best = distances.argmin(axis=-1)
    np.testing.assert_array_equal(median, np.take_along_axis(vectors, best[..., None, None], axis=2)[:, :, 0])


def _sums_of_quarters(choose: Choose, planes: np.ndarray) -> np.ndarray:
    """Sum up all squares of 5 x 5 samples, and check that against numpy's windows."""
    windows = np.lib.stride_tricks.sliding_window_view(planes, (5, 5), (2, 3))
    sums = np.empty(windows.shape[:4], np.uint16)
    for phase in np.ndindex(*planes.shape[:2]):
        choose(_kernels.box_sums)(planes[phase], 5, sums[phase])
    np.testing.assert_array_equal(sums, windows.sum(axis=(4, 5)))
    return sums


@pytest.mark.parametrize("smoothness", [0, 40])
def test_search_target(choose: Choose, planes: list[np.ndarray], smoothness: int) -> None:
    target = np.pad(moving_texture(3, 14, 22, (0.75, -1.5))[1].luma, MARGIN, mode="edge")
    offsets = np.array([[[0, 0], [4, -6], [0, 300]], [[-400, 2], [3, 3], [1, -1]]])
    expected, expected_costs = reference.search_target(
        target, planes[0], MARGIN, 8, 10, 1, 2, smoothness, offsets
    )
    costs = np.empty(offsets.shape[:2], np.int64)
    sums = [_sums_of_quarters(choose, image) for image in (target[None, None], planes[0])]
    searched = _kernels.Searched(target[None, None], sums[0]), _kernels.Searched(planes[0], sums[1])
    settings = _kernels.Blocks(MARGIN, 8, 10), _kernels.Steps(1, 2, smoothness)
    choose(_kernels.search_target)(*searched, *settings, offsets, costs)
    np.testing.assert_array_equal(offsets, expected)
    np.testing.assert_array_equal(costs, expected_costs)
    contented = _kernels.Steps(1, 2, smoothness, 256.0)
    choose(_kernels.search_target)(*searched, settings[0], contented, offsets, costs)
    np.testing.assert_array_equal(offsets, expected)


def test_accumulate_blocks(choose: Choose, planes: list[np.ndarray]) -> None:
    rng = np.random.default_rng(2)
    offsets = rng.integers(-30, 31, (2, 3, 2))
    offsets[1, 1] = (900, -900)
    weights = rng.uniform(0.1, 1.0, (2, 3))
    taper = rng.uniform(0.0, 1.0, (16, 16))
    total, mass = np.zeros((24, 32)), np.zeros((24, 32))
    choose(_kernels.accumulate_blocks)(planes[0], MARGIN, 8, taper, offsets, weights, total, mass)
    expected = reference.accumulate_blocks(planes[0], MARGIN, 8, taper, offsets, weights)
    np.testing.assert_allclose(total, expected[0], rtol=1e-12)
    np.testing.assert_allclose(mass, expected[1], rtol=1e-12)
