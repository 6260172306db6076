"""The folder of a map: its files agree with it; its page holds cameras, depth and clouds within bounds."""

import base64
import json
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from dvc.video import Frame
from sfm.mapping.scene_map import MapPiece, SceneMap
from sfm.output import scene_folder
from sfm.output.scene_folder import (
    Thinned,
    cloud_values,
    nearness,
    overview,
    piece_values,
    scaled_intrinsics,
    shown_size,
    write_scene,
)
from tests.sfm.plane_map import WALL, frames_of, intrinsics_of, map_of, piece_of, pose_at

SIZE = (47, 33)
FILES = {"depth", "depth.json", "intrinsics.json", "points.ply", "sparse", "trajectory.txt"}


def written(folder: Path, scene: SceneMap) -> dict[str, object]:
    write_scene(folder, scene, frames_of(*SIZE), 25.0)
    values: dict[str, object] = json.loads((folder / "scene.json").read_text())
    return values


def test_files_of_one_piece_agree_with_the_map(tmp_path: Path) -> None:
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
    intrinsics = json.loads((tmp_path / "intrinsics.json").read_text())
    np.testing.assert_array_equal(intrinsics["matrix"], piece.intrinsics)
    assert (intrinsics["size"], intrinsics["centre_of_first_pixel"]) == (list(SIZE), [0, 0])
    assert np.loadtxt(tmp_path / "trajectory.txt").shape == (9, 8)


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
    read = np.loadtxt(tmp_path / "trajectory.txt")[2, 1:4]
    np.testing.assert_allclose(-piece.poses[2][:, :3] @ read, piece.poses[2][:, 3], atol=1e-8)


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
    (tmp_path / "none").mkdir()
    values = written(tmp_path / "none", map_of(size=SIZE))  # the summary and a page, and no piece
    assert {path.name for path in (tmp_path / "none").iterdir()} == {"index.html", "scene.json"}
    assert values["summary"] == "map: no frame of 12 located: few points, or no parallax"


def test_large_clouds_are_thinned_for_colmap_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_folder, "MAX_SPARSE_POINTS", 50)
    piece = piece_of(range(2), *SIZE)
    written(tmp_path, map_of(piece, size=SIZE))
    lines = (tmp_path / "sparse" / "points3D.txt").read_text().splitlines()
    assert len([line for line in lines if not line.startswith("#")]) == 50
    assert len(trimesh.load(tmp_path / "points.ply").vertices) == len(piece.points) > 50


def test_frames_are_asked_for_in_order(tmp_path: Path) -> None:
    asked = []

    def frame(number: int) -> Frame:
        asked.append(number)
        return frames_of(*SIZE)(number)

    write_scene(tmp_path, map_of(piece_of(range(6), *SIZE), size=SIZE), frame)
    assert asked == sorted(asked)
    assert set(asked) == set(range(6))


def test_resized_pictures_have_their_cameras() -> None:
    assert [shown_size(size) for size in ((352, 288), (10000, 1))] == [(352, 288), (960, 1)]
    assert shown_size((1920, 1080)) == (960, 540)
    intrinsics = intrinsics_of(1920, 1080)
    scaled = scaled_intrinsics(intrinsics, (1920, 1080), (960, 540))
    for corner in ((-0.5, -0.5), (1919.5, 1079.5)):
        ray = np.linalg.solve(intrinsics, [*corner, 1.0])
        x, y, _ = scaled @ ray
        np.testing.assert_allclose([2 * x + 0.5, 2 * y + 0.5], corner, atol=1e-9)


def test_strays_and_unknown_depths_are_left_out() -> None:
    depth = np.full((40, 50), 2.0, np.float32)
    depth[0, :4] = np.nan, np.inf, -1.0, 0.01
    near, known = nearness(depth)
    assert not known[0, :4].any()
    assert known.sum() == depth.size - 4
    assert (near[known] == 0.5).all()
    assert not nearness(np.full((2, 2), np.nan, np.float32))[1].any()


def test_clouds_come_back() -> None:
    """Positions to half a step of the box, colours exactly; points far from all others are left out."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(500, 3))
    points[7], points[9] = 1e6, np.nan
    colours = rng.integers(0, 256, (500, 3)).astype(np.uint8)
    values = cloud_values(points, colours, 1000)
    kept = np.delete(np.arange(500), [7, 9])
    assert values["count"] == 498
    stored = np.frombuffer(zlib.decompress(base64.b64decode(values["codes"])), np.uint8).reshape(9, -1)
    codes = 256 * stored[0:6:2].astype(int) + stored[1:6:2] - 1
    found = (np.array(values["low"]) + codes.T * np.array(values["unit"])).astype(float)
    assert (np.abs(found - points[kept]) <= 0.51 * np.array(values["unit"])).all()
    np.testing.assert_array_equal(stored[6:].T, colours[kept])
    assert 0.0 < values["spacing"] < 1.0
    assert cloud_values(points, colours, 100)["count"] == 100
    nothing = cloud_values(np.empty((0, 3)), np.empty((0, 3), np.uint8), 100)
    assert (nothing["count"], nothing["spacing"]) == (0, 0.0)


def test_pieces_are_told_with_all_their_cameras() -> None:
    piece = piece_of(range(5), *SIZE)
    values = piece_values(piece, frames_of(*SIZE), SIZE, 1)
    assert values["frames"] == [0, 1, 2, 3, 4]
    assert [source["frame"] for source in values["sources"]] == [0, 2, 4]
    assert [picture["frame"] for picture in values["pictures"]] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(values["rotations"][3], piece.poses[3][:, :3].ravel(), atol=1e-8)
    picture = np.frombuffer(base64.b64decode(values["pictures"][1]["picture"]), np.uint8)
    assert cv2.imdecode(picture, cv2.IMREAD_COLOR).shape == (33, 47, 3)


def test_long_sequences_have_fewer_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_folder, "MAX_SOURCES", 4)
    monkeypatch.setattr(scene_folder, "PICTURE_BYTES", 8000)
    piece = piece_of(range(20), *SIZE)
    values = piece_values(piece, frames_of(*SIZE), SIZE, 2)
    assert len(values["frames"]) == 20
    assert [source["frame"] for source in values["sources"]] == [0, 8, 16]
    sizes = [len(picture["picture"]) for picture in values["pictures"]]
    assert 1 < len(sizes) < 20
    assert sum(sizes) <= 4000


def test_large_depth_maps_are_made_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_folder, "MAX_SIDE_PX", 24)
    monkeypatch.setattr(scene_folder.shown_size, "__defaults__", (24,))
    values = piece_values(piece_of(range(2), *SIZE), frames_of(*SIZE), SIZE, 1)
    (part,) = values["sources"][0]["pieces"]
    assert (part["width"], part["height"]) == (24, 17)
    picture = np.frombuffer(base64.b64decode(part["picture"]), np.uint8)
    assert cv2.imdecode(picture, cv2.IMREAD_COLOR).shape == (17, 24, 3)
    assert values["intrinsic"][0] == pytest.approx(intrinsics_of(*SIZE)[0, 0] * 24 / 47)


def test_directions_are_those_of_the_cameras() -> None:
    """Up is against the rows; within the radius are nearly all points and all cameras."""
    piece = piece_of(range(6), 47, 33)
    found = overview(piece)
    assert np.dot(found["up"], [0.0, -1.0, 0.0]) > 0.95
    assert np.dot(found["ahead"], [0.0, 0.0, 1.0]) > 0.95
    assert np.linalg.norm(found["up"]) == pytest.approx(1.0)
    away = np.linalg.norm(piece.points - found["middle"], axis=1)
    assert (away <= found["radius"]).mean() >= 0.75
    assert all(
        np.linalg.norm(-pose[:, :3].T @ pose[:, 3] - found["middle"]) <= found["radius"]
        for pose in piece.poses.values()
    )
    assert 0.5 * WALL < found["depth"] < 1.1 * WALL
    # A camera without points looks ahead, and odd points do no harm.
    none, odd = np.empty((0, 3)), np.full((2, 3), np.nan)
    alone, among = (
        overview(MapPiece(intrinsics_of(8, 8), {3: pose_at(3)}, xyz, np.zeros(xyz.shape, np.uint8), {}))
        for xyz in (none, odd)
    )
    assert alone == among
    assert alone["radius"] > 0.0
    assert np.isfinite(alone["middle"]).all()


@pytest.mark.parametrize(
    ("count", "limits", "size", "expected"),
    [
        (10, (100, 10), 1, range(10)),  # within both limits
        (40, (70, 100), 10, range(0, 40, 8)),  # evenly spaced
        (9, (1, 3), 10, [0]),  # the first one stays in any case
    ],
)
def test_series_are_thinned(count: int, limits: tuple[int, int], size: int, expected: list[int]) -> None:
    made: list[int] = []
    thinned = Thinned(*limits, lambda item: size)
    for number in range(count):
        thinned.offer(lambda number=number: made.append(number) or number)  # type: ignore[misc]
    assert thinned.items == list(expected)
    assert len(made) < 20
