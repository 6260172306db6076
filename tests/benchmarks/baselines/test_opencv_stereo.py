"""Baseline of stereo: holes are filled, and real sets give published figures."""

import numpy as np
import pytest

from benchmarks.baselines.opencv_stereo import fill_holes, semi_global_baseline
from benchmarks.thesis.scenes import PAIRS, TSUKUBA, RealSet
from tests.stereo.data import REAL_SETS, pair_of_planes, real_set

SEEN_ELSEWHERE = {"tsukuba": 6.0, "venus": 3.8, "teddy": 16.6, "cones": 11.5}
"""Bad pixels of StereoSGBM with holes filled, all, in per cent."""
ANTINOUS = RealSet(
    "antinous", "input_Cam040.png", "input_Cam042.png", "-3.25:2.75:0.125", "gt_disp_lowres.pfm"
)


def test_holes_take_the_smaller_side() -> None:
    """A hole is filled from behind, at the border from the only side, and an empty row is 0."""
    nan = np.nan
    disparity = np.array([[nan, 3.0, nan, nan, 9.0, nan], [nan] * 6, [1.0, nan, 0.5, 2.0, nan, 2.5]])
    expected = [[3.0, 3.0, 3.0, 3.0, 9.0, 9.0], [0.0] * 6, [1.0, 0.5, 0.5, 2.0, 2.0, 2.5]]
    np.testing.assert_array_equal(fill_holes(disparity), expected)


def test_planes_are_found() -> None:
    """On a pair without noise nearly all pixels are right, and none is without a value."""
    left, right, truth = pair_of_planes(96, 160)
    found = semi_global_baseline(left, right, 8.0)
    assert np.isfinite(found).all()
    assert np.mean(np.abs(found - truth) > 1.0) < 0.1


@pytest.mark.parametrize("name", PAIRS)
def test_baseline_is_as_good_as_elsewhere(name: str) -> None:
    """On the real pairs it is within half a per cent of published figures."""
    real_set(name)
    one = PAIRS[name]
    left, right = one.pair(REAL_SETS)
    found = semi_global_baseline(left.image, right.image, one.labels.highest)
    bad = one.evaluate(REAL_SETS, found)["all"].bad_percent[1.0]
    assert bad == pytest.approx(SEEN_ELSEWHERE[name], abs=0.5)


@pytest.mark.parametrize("one", [TSUKUBA, ANTINOUS], ids=lambda one: one.name)
def test_cameras_around_the_reference(one: object) -> None:
    """Two cameras are the reference and its right neighbour, five a cross, 25 all."""
    assert isinstance(one, type(TSUKUBA))
    real_set(one.name)
    for count in (2, 5, 25):
        files, positions = one.array_files(REAL_SETS, count)
        assert len(files) == len(positions) == count
        assert (0.0, 0.0) in positions
        assert all(path.exists() for path in files)
        if count == 5:
            assert np.sum(positions, axis=0).tolist() == [0.0, 0.0]
