"""COLMAP's text files: COLMAP reads what is written."""

from pathlib import Path

import numpy as np
import pytest

from sfm.output.map_files import ColmapCloud, ColmapImage, write_colmap_text
from tests.sfm.plane_map import intrinsics_of, pose_at


@pytest.mark.parametrize("ratio", [1.0, 1.07])
def test_colmap_reads_cameras_and_points(tmp_path: Path, ratio: float) -> None:
    """Poses, focal lengths, colours are equal, and the principal point is half a pixel farther."""
    import pycolmap

    intrinsics = intrinsics_of(61, 47)
    intrinsics[1, 1] *= ratio
    images = [ColmapImage(number + 1, f"{number:06d}.png", pose_at(number)) for number in (0, 3, 8)]
    rng = np.random.default_rng(1)
    cloud = ColmapCloud(rng.normal(size=(20, 3)), rng.integers(0, 256, (20, 3)).astype(np.uint8))
    write_colmap_text(tmp_path, (61, 47), intrinsics, images, cloud)
    read = pycolmap.Reconstruction(tmp_path)
    assert read.num_reg_images() == 3
    for number, name, pose, _ in images:
        assert read.images[number].name == name
        np.testing.assert_allclose(read.images[number].cam_from_world().matrix(), pose, atol=1e-10)
    camera = read.cameras[1]
    assert (camera.width, camera.height) == (61, 47)
    expected = intrinsics + np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(camera.calibration_matrix(), expected, rtol=1e-10)
    assert camera.model.name == ("SIMPLE_PINHOLE" if ratio == 1.0 else "PINHOLE")
    points = [read.points3D[k + 1] for k in range(20)]
    np.testing.assert_allclose([point.xyz for point in points], cloud.points, rtol=1e-9)
    np.testing.assert_array_equal([point.color for point in points], cloud.colours)


def test_skew_is_refused(tmp_path: Path) -> None:
    """These cameras of COLMAP cannot have it."""
    skewed = intrinsics_of(8, 8)
    skewed[0, 1] = 0.5
    cloud = ColmapCloud(np.empty((0, 3)), np.empty((0, 3), np.uint8))
    with pytest.raises(ValueError, match="no skew"):
        write_colmap_text(tmp_path, (8, 8), skewed, [], cloud)
