"""Depth maps of 16 bits."""

from pathlib import Path

import cv2
import numpy as np

from sfm.output.map_files import depth_levels, depth_step, write_depth_maps


def test_depths_come_back_to_half_a_step(tmp_path: Path) -> None:
    """The largest has the largest level, and what is not known is 0."""
    rng = np.random.default_rng(5)
    depths = {number: rng.uniform(0.5, 90.0, (7, 11)).astype(np.float32) for number in (4, 100)}
    depths[4][2, 3], depths[4][0, 0], depths[100][1, 1] = np.nan, np.inf, -1.0
    step = depth_step(depths)
    write_depth_maps(tmp_path, depths, step)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000004.png", "000100.png"]
    largest = 0
    for number, depth in depths.items():
        levels = cv2.imread(str(tmp_path / f"{number:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert levels.dtype == np.uint16
        known = np.isfinite(depth) & (depth > 0)
        np.testing.assert_array_equal(levels > 0, known)
        assert np.abs(levels[known] * step - depth[known]).max() <= 0.5001 * step
        largest = max(largest, int(levels.max()))
    assert largest == 65535


def test_small_and_absent_depths() -> None:
    """What is known is never written as unknown, and no depth needs no range."""
    assert depth_step({}) == 1.0
    assert depth_step({0: np.full((2, 2), np.nan, np.float32)}) == 1.0
    near = np.array([[1e-6, 100.0]], np.float32)
    np.testing.assert_array_equal(depth_levels(near, depth_step({0: near})), [[1, 65535]])
