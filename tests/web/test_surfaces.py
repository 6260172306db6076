"""Pictures with depth in a page: disparities in few bytes."""

import zlib

import numpy as np
import pytest

from dvc.web.surfaces import MAX_CODE, disparity_codes, pack_codes


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
    """One disparity needs no range, and none at all is all zero."""
    codes, lowest, unit = disparity_codes(np.full((2, 3), 4.0), mask)
    np.testing.assert_array_equal(codes, mask)
    assert unit > 0.0
    assert lowest == (4.0 if mask.any() else 0.0)
