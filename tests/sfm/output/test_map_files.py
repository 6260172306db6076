"""Files of maps and of scenes of two pictures: COLMAP's models, clouds, camera paths and depth maps."""

import json
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from sfm.output.map_files import (
    colmap_model,
    depth_step,
    metric_upgrade,
    point_colours,
    to_dict,
    write_depth_maps,
    write_model,
    write_ply,
    write_trajectory,
)
from sfm.scene_model import Reconstruction
from tests.sfm.plane_map import intrinsics_of, pose_at
from tests.sfm.two_views import FOCAL_LENGTH, FRAME, euclidean_scene


@pytest.mark.parametrize("ratio", [1.0, 1.07])
def test_colmap_reads_cameras_and_points(tmp_path: Path, ratio: float) -> None:
    """Poses, focal lengths and colours are equal, and the principal point moves by half a pixel."""
    intrinsics = intrinsics_of(61, 47)
    intrinsics[1, 1] *= ratio
    poses = {f"{number:06d}.png": pose_at(number) for number in (0, 3, 8)}
    rng = np.random.default_rng(1)
    cloud = rng.normal(size=(20, 3)), rng.integers(0, 256, (20, 3)).astype(np.uint8)
    colmap_model((61, 47), intrinsics, poses, cloud).write_text(tmp_path)
    read = pycolmap.Reconstruction(tmp_path)
    assert read.num_reg_images() == 3
    for name, pose in poses.items():
        image = read.find_image_with_name(name)
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose, atol=1e-10)
    camera = read.cameras[1]
    assert (camera.width, camera.height) == (61, 47)
    expected = intrinsics + np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(camera.calibration_matrix(), expected, rtol=1e-10)
    assert camera.model.name == ("SIMPLE_PINHOLE" if ratio == 1.0 else "PINHOLE")
    points = [read.points3D[k + 1] for k in range(20)]
    np.testing.assert_allclose([point.xyz for point in points], cloud[0], rtol=1e-9)
    np.testing.assert_array_equal([point.color for point in points], cloud[1])


def test_skew_is_refused() -> None:
    skewed = intrinsics_of(8, 8)
    skewed[0, 1] = 0.5
    with pytest.raises(ValueError, match="no skew"):
        colmap_model((8, 8), skewed, {}, (np.empty((0, 3)), np.empty((0, 3), np.uint8)))


@pytest.mark.parametrize("count", [0, 30])
def test_clouds_are_read_by_other_programs(tmp_path: Path, count: int) -> None:
    """Trimesh reads positions in single precision, and colours; the comment is in the header."""
    rng = np.random.default_rng(3)
    points, colours = rng.normal(size=(count, 3)), rng.integers(0, 256, (count, 3)).astype(np.uint8)
    write_ply(tmp_path / "cloud.ply", points, colours, "a comment")
    assert b"comment a comment\n" in (tmp_path / "cloud.ply").read_bytes()
    if count:
        cloud = trimesh.load(tmp_path / "cloud.ply")
        np.testing.assert_array_equal(cloud.vertices, points.astype(np.float32))
        np.testing.assert_array_equal(cloud.colors[:, :3], colours)


@pytest.mark.parametrize("fps", [None, 25.0, Fraction(30000, 1001)])
def test_path_comes_back(tmp_path: Path, fps: Fraction | float | None) -> None:
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
    write_trajectory(tmp_path / "trajectory.txt", {}, None)
    assert all(line.startswith("#") for line in (tmp_path / "trajectory.txt").read_text().splitlines())


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


def test_small_and_absent_depths(tmp_path: Path) -> None:
    assert depth_step({}) == 1.0
    assert depth_step({0: np.full((2, 2), np.nan, np.float32)}) == 1.0
    near = np.array([[1e-6, 100.0]], np.float32)
    write_depth_maps(tmp_path, {0: near}, depth_step({0: near}))
    levels = cv2.imread(str(tmp_path / "000000.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(levels, [[1, 65535]])


@pytest.mark.parametrize("plane", [(0.0, 0.0, 0.0), (0.1, -0.1, 0.05)])
def test_metric_upgrade_finds_the_truth(plane: tuple[float, float, float]) -> None:
    """From any nearly Euclidean frame, focal length within 2 %, rotation within 0.1 degrees."""
    truth = euclidean_scene(plane=plane)
    metric = metric_upgrade(truth.model)
    assert abs(metric.focal_length_px / FRAME.scale_px / FOCAL_LENGTH - 1) < 0.02
    turn = metric.second_from_first[:, :3] @ truth.rotation.T
    assert np.degrees(np.arccos(min(1.0, (np.trace(turn) - 1) / 2))) < 0.1
    direction = truth.translation / np.linalg.norm(truth.translation)
    np.testing.assert_allclose(metric.second_from_first[:, 3], direction, atol=0.005)
    assert metric.error_px < 0.3


def test_colmap_reads_what_is_written(tmp_path: Path) -> None:
    model = euclidean_scene(plane=(0.05, 0.0, 0.0)).model
    luma = np.full((288, 352), 77, dtype=np.uint8)
    write_model(tmp_path, model, point_colours(luma, model.correspondences.first))
    read = pycolmap.Reconstruction(tmp_path)
    assert read.num_reg_images() == 2
    assert read.num_points3D() == len(model.correspondences)
    image = read.images[2]
    errors = [
        np.linalg.norm(image.project_point(read.points3D[point.point3D_id].xyz) - point.xy)
        for point in image.points2D
    ]
    assert max(errors) < 0.5
    assert {tuple(point.color) for point in read.points3D.values()} == {(77, 77, 77)}
    cloud = trimesh.load(tmp_path / "points.ply")
    np.testing.assert_allclose(cloud.vertices, metric_upgrade(model).points, rtol=1e-6)
    assert (cloud.colors[:, :3] == 77).all()


def test_values_of_a_model() -> None:
    truth = euclidean_scene(num_points=12)
    reconstruction = Reconstruction(truth.model, "", "general", {"matching": truth.model.correspondences})
    values = json.loads(json.dumps(to_dict(reconstruction)))
    assert values["num_correspondences"] == {"matching": 12}
    np.testing.assert_allclose(values["model"]["depths"], truth.model.depths, atol=1e-6)
    assert to_dict(Reconstruction(None, "black", "unknown"))["model"] is None
