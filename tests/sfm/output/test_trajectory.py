"""Camera paths in TUM's format."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfm.output.map_files import write_trajectory
from tests.sfm.plane_map import pose_at


@pytest.mark.parametrize("fps", [None, 25.0, Fraction(30000, 1001)])
def test_path_comes_back(tmp_path: Path, fps: Fraction | float | None) -> None:
    """Lines are in order of time, and turned round they are the poses."""
    poses = {number: pose_at(number) for number in (7, 0, 3)}
    write_trajectory(tmp_path / "trajectory.txt", poses, fps)
    read = np.loadtxt(tmp_path / "trajectory.txt")
    assert read.shape == (3, 8)
    np.testing.assert_allclose(read[:, 0], np.array([0, 3, 7]) / float(fps or 1), atol=1e-6)
    for row, number in zip(read, (0, 3, 7), strict=True):
        rotation = Rotation.from_quat(row[4:]).as_matrix().T
        found = np.column_stack([rotation, -rotation @ row[1:4]])
        np.testing.assert_allclose(found, poses[number], atol=1e-8)


def test_no_camera_leaves_comments(tmp_path: Path) -> None:
    """Nothing but comments is in the file."""
    write_trajectory(tmp_path / "trajectory.txt", {}, None)
    assert all(line.startswith("#") for line in (tmp_path / "trajectory.txt").read_text().splitlines())
