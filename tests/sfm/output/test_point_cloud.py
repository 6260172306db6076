"""Clouds as PLY files: what is written is read again, by others, too."""

from pathlib import Path

import numpy as np
import pytest

from sfm.output.map_files import read_ply, write_ply


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_points_and_colours_come_back(tmp_path: Path, count: int) -> None:
    """Positions in single precision, colours as they are."""
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    colours = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    write_ply(tmp_path / "cloud.ply", points, colours, "a comment")
    assert b"comment a comment\n" in (tmp_path / "cloud.ply").read_bytes()
    read_points, read_colours = read_ply(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(read_points, points.astype(np.float32))
    np.testing.assert_array_equal(read_colours, colours)


def test_trimesh_reads_the_same(tmp_path: Path) -> None:
    """Another program finds the same points."""
    trimesh = pytest.importorskip("trimesh")
    points = np.arange(30.0).reshape(10, 3)
    colours = np.arange(30, dtype=np.uint8).reshape(10, 3)
    write_ply(tmp_path / "cloud.ply", points, colours, "points")
    cloud = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(cloud.vertices, points)
    np.testing.assert_array_equal(cloud.colors[:, :3], colours)


def test_other_files_are_refused(tmp_path: Path) -> None:
    """A cloud without colours is none of these."""
    (tmp_path / "cloud.ply").write_bytes(b"ply\nelement vertex 0\nproperty float x\nend_header\n")
    with pytest.raises(ValueError, match="not a cloud"):
        read_ply(tmp_path / "cloud.ply")
