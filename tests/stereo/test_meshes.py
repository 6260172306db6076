"""Meshes and point sets: geometry, tears, files that trimesh reads back."""

import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import DisparityLabels
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import extract_sprites
from dvc.stereo.meshes import (
    DEPTH_RANGE,
    Shape,
    check_outputs,
    points_in_world,
    points_of_disparity,
    scene_shape,
    surface_shape,
    write_shape,
)
from dvc.stereo.rectification.rectified_array import rectify
from tests.stereo.rigs import random_rig


def test_depth_is_inverse_disparity() -> None:
    """Far from infinity, twice the disparity is half the depth; points lie on the rays of pixels."""
    disparity = np.array([[10.0, 20.0, 40.0]])
    points = points_of_disparity(disparity, 10.0, 40.0)
    np.testing.assert_allclose(points[0, :, 2], [4.0, 2.0, 1.0])
    np.testing.assert_allclose(points[0, :, 0] / points[0, :, 2], np.array([-1.0, 0.0, 1.0]) / 3)


@pytest.mark.parametrize("lowest", [-14.0, 0.0, 0.1])
def test_infinity_stays_outside(lowest: float) -> None:
    disparity = np.linspace(lowest, 8.0, 9)[None]
    depth = points_of_disparity(disparity, lowest, 8.0)[0, :, 2]
    assert depth[-1] == pytest.approx(1.0)
    assert depth[0] == pytest.approx(DEPTH_RANGE)
    assert (np.diff(depth) < 0.0).all()


def made_shape() -> Shape:
    disparity = np.array([[1.0, 1.0, 9.0], [1.0, 1.0, 9.0], [1.0, 1.0, 9.0]])
    image = np.arange(27, dtype=np.uint8).reshape(3, 3, 3)
    return surface_shape(points_of_disparity(disparity, 1.0, 9.0), image, disparity, 1.0)


def test_mesh_is_torn_at_discontinuities() -> None:
    """Triangles join neighbours of like disparity, face the camera, and leave jumps open."""
    shape = made_shape()
    assert shape.points.shape == (9, 3)
    assert shape.triangles.shape == (4, 3)
    assert not np.isin(shape.triangles, [2, 5, 8]).any()
    corners = shape.points[shape.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0.0).all()


def test_pixels_can_be_left_out() -> None:
    kept = np.ones((3, 3), np.bool_)
    kept[0, 0] = False
    flat = np.ones((3, 3))
    shape = surface_shape(np.zeros((3, 3, 3)), np.zeros((3, 3, 3), np.uint8), flat, 1.0, kept)
    assert len(shape.points) == 8
    assert len(shape.triangles) == 7
    assert shape.triangles.max() == 7


@pytest.mark.parametrize("ending", ["ply", "glb"])
@pytest.mark.parametrize("as_points", [False, True])
def test_files_are_read_back(tmp_path: Path, ending: str, as_points: bool) -> None:
    trimesh = pytest.importorskip("trimesh")
    shape = made_shape()
    if as_points:
        shape = Shape(shape.points, shape.colours, np.zeros((0, 3), np.int64))
    path = tmp_path / f"shape.{ending}"
    write_shape(path, shape)
    loaded = next(iter(trimesh.load_scene(path, process=False).geometry.values()))
    expected = shape.points * ([1.0, -1.0, -1.0] if ending == "glb" else 1.0)
    np.testing.assert_allclose(loaded.vertices, expected, atol=1e-5)
    colours = loaded.colors if as_points else loaded.visual.vertex_colors
    np.testing.assert_array_equal(np.asarray(colours)[:, :3], shape.colours)


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_nothing_is_no_mesh(tmp_path: Path, ending: str) -> None:
    nothing = Shape(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.int64))
    with pytest.raises(DvcError, match="has no points"):
        write_shape(tmp_path / f"shape.{ending}", nothing)
    assert not list(tmp_path.iterdir())


def test_names_are_checked_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def _checked(ply: str | None = None, glb: str | None = None) -> list[Path]:
        return check_outputs(Namespace(out=str(tmp_path), json=None, ply=ply, glb=glb), [])

    with pytest.raises(ConfigError, match=r"ends in \.ply"):
        _checked("mesh.obj")
    assert _checked() == []
    assert _checked(str(tmp_path / "a.PLY")) == [tmp_path / "a.PLY"]
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ConfigError, match=r"dvc3d\[mesh\]"):
        _checked(glb="a.glb")


def test_calibrated_points_are_where_cameras_see_them() -> None:
    """A point of a rectified view, put into the world, is seen there again, by that camera and by another."""
    rig = random_rig(5, [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    found = rectify(rig)
    disparity = np.linspace(4.0, 9.0, 30).reshape(5, 6)
    points, known = points_in_world(disparity, found.positions[1], found)
    assert known.all()
    y, x = (axis.ravel().astype(np.float64) for axis in np.indices(disparity.shape))
    for index in (1, 2):
        moved = np.subtract(found.positions[index], found.positions[1])
        expected = np.column_stack([x - moved[0] * disparity.ravel(), y - moved[1] * disparity.ravel()])
        image = np.column_stack([points.reshape(-1, 3), np.ones(30)]) @ rig[index].projection.T
        seen = found.rectified_points(index, image[:, :2] / image[:, 2:])
        np.testing.assert_allclose(seen, expected, atol=1e-6)


def test_nothing_is_behind_the_camera() -> None:
    canvas = Canvas((2, 3), Frame(0, 0, 3, 2), DisparityLabels(1.0, 1.0, 8), 1.0, "middle", 2)
    disparity = np.array([[[2.0, 2.0, 0.0], [2.0, 2.0, -0.5]]], np.float32)
    image = LayeredDepthImage(
        canvas, np.zeros((1, 2, 3, 3), np.uint8), disparity, np.ones((1, 2, 3), np.uint16)
    )
    for shape in map(scene_shape, (image, extract_sprites(image))):
        assert len(shape.points) == 4
        assert (shape.points[:, 2] == 0.5).all()
        assert len(shape.triangles) == 2
