"""Pictures for people, line plots, and disparities of a page in few bytes."""

import zlib

import numpy as np
import pytest

from dvc.web.drawing import (
    BAD,
    GOOD,
    UNKNOWN,
    colour_counts,
    colour_disparity,
    colour_error,
    disparity_legend,
    in_rows,
    with_title,
)
from dvc.web.plotting import SUFFIXES, Line, line_plot
from dvc.web.surfaces import MAX_CODE, disparity_codes, pack_codes


def test_near_is_brighter() -> None:
    picture = colour_disparity(np.array([[np.nan, -2.0, 0.0, 2.0, 9.0]]), -2.0, 2.0)
    luma = picture[0].astype(np.float64) @ [0.114, 0.587, 0.299]
    assert tuple(picture[0, 0]) == UNKNOWN
    assert luma[1] < luma[2] < luma[3]
    assert luma[3] == luma[4]
    constant = colour_disparity(np.full((3, 4), 5.0), 5.0, 5.0)
    assert (constant == constant[0, 0]).all()


def test_errors_have_three_colours() -> None:
    error = np.array([[0.4, 0.6, 1.0, 1.01, np.inf, 0.0]])
    counted = np.array([[True, True, True, True, True, False]])
    picture = colour_error(error, counted)
    assert tuple(picture[0, 0]) == GOOD
    assert tuple(picture[0, 1]) == tuple(picture[0, 2])
    assert tuple(picture[0, 3]) == tuple(picture[0, 4]) == BAD
    assert tuple(picture[0, 5]) == UNKNOWN


def test_counts_are_even_steps() -> None:
    assert colour_counts(np.array([[0, 1, 2, 3]]), 3)[0, :, 0].tolist() == [0, 85, 170, 255]


def test_panels_keep_pictures() -> None:
    rng = np.random.default_rng(3)
    pictures = [rng.integers(0, 256, (20, 90, 3)).astype(np.uint8) for _ in range(3)]
    joined = in_rows([with_title(picture, "title") for picture in pictures], 2)
    assert joined.shape == (2 * 46 + 8, 2 * 90 + 8, 3)
    np.testing.assert_array_equal(joined[26:46, :90], pictures[0])
    np.testing.assert_array_equal(joined[26:46, 98:], pictures[1])
    np.testing.assert_array_equal(joined[54 + 26 :, :90], pictures[2])
    assert (joined[54:, 98:] == 255).all()
    assert disparity_legend(200, 0.0, 15.0).shape[1] == 200


def test_the_same_lines_give_the_same_bytes() -> None:
    lines = [Line("first", [0.1, 0.2], [30.0, 31.0]), Line("_cost in $ \u540d", [0.1, 0.3], [29.0, 30.5])]
    drawn = line_plot(lines, "title", "rate", "PSNR")
    assert set(drawn) == set(SUFFIXES)
    assert drawn == line_plot(lines, "title", "rate", "PSNR")
    text = drawn[".svg"].decode()
    assert "first" in text
    assert "cost in $" in text
    assert drawn[".png"].startswith(b"\x89PNG")


def unpacked(data: bytes, shape: tuple[int, int]) -> np.ndarray:
    """Undo `pack_codes` as the page does: running sums of high and low bytes."""
    high, low = np.frombuffer(zlib.decompress(data), np.uint8).reshape(2, *shape).astype(np.int64)
    return np.cumsum(256 * high + low, axis=1) & 0xFFFF


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("max_code", [MAX_CODE, 4095])
def test_disparities_survive_to_half_a_step(scale: float, max_code: int) -> None:
    """Codes give the disparities back to half a step of their range, and 0 is outside the mask."""
    rng = np.random.default_rng(3)
    disparity = scale * rng.normal(size=(7, 9))
    mask = rng.random((7, 9)) < 0.8
    codes, lowest, unit = disparity_codes(disparity, mask, max_code)
    found = unpacked(pack_codes(codes), codes.shape)
    np.testing.assert_array_equal(found > 0, mask)
    error = np.abs(lowest + (found[mask] - 1) * unit - disparity[mask])
    assert error.max() <= 0.51 * unit
    assert unit == pytest.approx(np.ptp(disparity[mask]) / (max_code - 1))


@pytest.mark.parametrize("mask", [np.zeros((2, 3), np.bool_), np.ones((2, 3), np.bool_)])
def test_constant_and_absent_disparities(mask: np.ndarray) -> None:
    codes, lowest, unit = disparity_codes(np.full((2, 3), 4.0), mask)
    np.testing.assert_array_equal(codes, mask)
    assert unit > 0.0
    assert lowest == (4.0 if mask.any() else 0.0)
