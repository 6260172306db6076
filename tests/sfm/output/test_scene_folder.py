"""The folder of a map: all its files agree with it, in one piece, several or none."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from dvc.video import Frame
from sfm.mapping.scene_map import MapPiece, SceneMap
from sfm.output import scene_folder
from sfm.output.scene_folder import write_scene
from tests.sfm.plane_map import frames_of, map_of, piece_of

SIZE = (47, 33)
FILES = {"depth", "depth.json", "intrinsics.json", "points.ply", "sparse", "trajectory.txt"}


def written(folder: Path, scene: SceneMap) -> dict[str, object]:
    """Write a map, and return what its summary says."""
    write_scene(folder, scene, frames_of(*SIZE), 25.0)
    values: dict[str, object] = json.loads((folder / "scene.json").read_text())
    return values


def test_files_of_one_piece_agree_with_the_map(tmp_path: Path) -> None:
    """Cameras, path, points and depth are those of the map."""
    import pycolmap

    piece = piece_of(range(9), *SIZE)
    values = written(tmp_path, map_of(piece, size=SIZE))
    assert {path.name for path in tmp_path.iterdir()} == FILES | {"index.html", "scene.json"}
    assert values["summary"] == "map: 1 piece, 9 of 12 frames located"
    assert values["size"] == list(SIZE)
    (told,) = values["pieces"]  # type: ignore[misc]
    assert told["folder"] == "."
    assert told["frames"] == list(range(9))
    assert told["depth_frames"] == [0, 2, 4, 6, 8]
    assert set(told["files"]) == FILES
    read = pycolmap.Reconstruction(tmp_path / "sparse")
    for number, pose in piece.poses.items():
        image = read.find_image_with_name(f"{number:06d}.png")
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose, atol=1e-9)
    intrinsics = json.loads((tmp_path / "intrinsics.json").read_text())
    np.testing.assert_array_equal(intrinsics["matrix"], piece.intrinsics)
    assert (intrinsics["size"], intrinsics["centre_of_first_pixel"]) == (list(SIZE), [0, 0])
    assert np.loadtxt(tmp_path / "trajectory.txt").shape == (9, 8)
    cloud = trimesh.load(tmp_path / "points.ply")
    np.testing.assert_allclose(cloud.vertices, piece.points, rtol=1e-6)
    np.testing.assert_array_equal(cloud.colors[:, :3], piece.colours)
    step = json.loads((tmp_path / "depth.json").read_text())["depth_of_a_level"]
    levels = cv2.imread(str(tmp_path / "depth" / "000004.png"), cv2.IMREAD_UNCHANGED)
    known = np.isfinite(piece.depths[4])
    assert np.abs(levels * step - piece.depths[4])[known].max() <= 0.5001 * step


def test_depth_and_cameras_project_to_the_points(tmp_path: Path) -> None:
    """What a reader makes of a depth map, the intrinsics and the path are points of the cloud."""
    piece = piece_of(range(3), *SIZE)
    written(tmp_path, map_of(piece, size=SIZE))
    step = json.loads((tmp_path / "depth.json").read_text())["depth_of_a_level"]
    depth = step * cv2.imread(str(tmp_path / "depth" / "000002.png"), cv2.IMREAD_UNCHANGED)
    matrix = np.array(json.loads((tmp_path / "intrinsics.json").read_text())["matrix"])
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    in_camera = depth[..., None] * (np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(matrix).T)
    in_world = (in_camera - piece.poses[2][:, 3]) @ piece.poses[2][:, :3]
    own = in_world[4::3, 4::3].reshape(-1, 3)
    np.testing.assert_allclose(own, piece.points[-len(own) :], atol=1e-3)


def test_pieces_stand_beside_each_other(tmp_path: Path) -> None:
    """The first one is in the folder itself; one without points and depth has all files as well."""
    empty = piece_of(range(8, 11), *SIZE)
    nothing = MapPiece(empty.intrinsics, empty.poses, np.empty((0, 3)), np.empty((0, 3), np.uint8), {})
    values = written(tmp_path, map_of(piece_of(range(4), *SIZE), nothing, size=SIZE))
    assert values["num_located"] == 7
    assert [piece["folder"] for piece in values["pieces"]] == [".", "piece-1"]  # type: ignore[attr-defined]
    assert {path.name for path in (tmp_path / "piece-1").iterdir()} == FILES
    assert b"element vertex 0\n" in (tmp_path / "piece-1" / "points.ply").read_bytes()
    assert not any((tmp_path / "piece-1" / "depth").iterdir())


def test_nothing_located_is_said(tmp_path: Path) -> None:
    """There is the summary and a page, and no piece."""
    values = written(tmp_path, map_of(size=SIZE))
    assert {path.name for path in tmp_path.iterdir()} == {"index.html", "scene.json"}
    assert values["summary"] == "map: no frame of 12 located: few points, or no parallax"


def test_large_clouds_are_thinned_for_colmap_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The PLY file has all points, COLMAP's text a selection of them."""
    monkeypatch.setattr(scene_folder, "MAX_SPARSE_POINTS", 50)
    piece = piece_of(range(2), *SIZE)
    written(tmp_path, map_of(piece, size=SIZE))
    lines = (tmp_path / "sparse" / "points3D.txt").read_text().splitlines()
    assert len([line for line in lines if not line.startswith("#")]) == 50
    assert len(trimesh.load(tmp_path / "points.ply").vertices) == len(piece.points) > 50


def test_frames_are_asked_for_in_order(tmp_path: Path) -> None:
    """A video is read once from front to back."""
    asked = []

    def frame(number: int) -> Frame:
        asked.append(number)
        return frames_of(*SIZE)(number)

    write_scene(tmp_path, map_of(piece_of(range(6), *SIZE), size=SIZE), frame)
    assert asked == sorted(asked)
    assert set(asked) == set(range(6))
