"""What the page of a map holds: cameras, depth without strays, clouds in few bytes, within bounds."""

import base64
import zlib

import cv2
import numpy as np
import pytest

from sfm.mapping.scene_map import MapPiece
from sfm.output import flight_page
from sfm.output.flight_page import (
    Shares,
    Thinned,
    cloud_values,
    nearness,
    overview,
    piece_values,
    scaled_intrinsics,
    shown_size,
)
from tests.sfm.plane_map import WALL, frames_of, intrinsics_of, piece_of, pose_at

SIZE = (47, 33)


def test_sizes_are_bounded() -> None:
    """Small frames stay as they are; large ones keep their shape."""
    assert shown_size((352, 288)) == (352, 288)
    assert shown_size((1920, 1080)) == (960, 540)
    assert shown_size((10000, 1)) == (960, 1)


def test_resized_pictures_have_their_cameras() -> None:
    """A corner of the picture is the same ray before and after."""
    intrinsics = intrinsics_of(1920, 1080)
    scaled = scaled_intrinsics(intrinsics, (1920, 1080), (960, 540))
    for corner in ((-0.5, -0.5), (1919.5, 1079.5)):
        ray = np.linalg.solve(intrinsics, [*corner, 1.0])
        x, y, _ = scaled @ ray
        np.testing.assert_allclose([2 * x + 0.5, 2 * y + 0.5], corner, atol=1e-9)


def test_strays_and_unknown_depths_are_left_out() -> None:
    """Infinity, nan, what lies behind, and what is absurdly near."""
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
    """Each frame has a camera, frames with depth are sources, and pictures are files."""
    piece = piece_of(range(5), *SIZE)
    values = piece_values(piece, frames_of(*SIZE), SIZE, Shares.of(1))
    assert values["frames"] == [0, 1, 2, 3, 4]
    assert [source["frame"] for source in values["sources"]] == [0, 2, 4]
    assert [picture["frame"] for picture in values["pictures"]] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(values["rotations"][3], piece.poses[3][:, :3].ravel(), atol=1e-8)
    picture = np.frombuffer(base64.b64decode(values["pictures"][1]["picture"]), np.uint8)
    assert cv2.imdecode(picture, cv2.IMREAD_COLOR).shape == (33, 47, 3)


def test_long_sequences_have_fewer_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both kinds stay within their sizes, evenly spaced; all cameras remain."""
    monkeypatch.setattr(flight_page, "MAX_SOURCES", 4)
    piece = piece_of(range(20), *SIZE)
    values = piece_values(piece, frames_of(*SIZE), SIZE, Shares(10**7, 4000, 100))
    assert len(values["frames"]) == 20
    assert [source["frame"] for source in values["sources"]] == [0, 8, 16]
    sizes = [len(picture["picture"]) for picture in values["pictures"]]
    assert 1 < len(sizes) < 20
    assert sum(sizes) <= 4000
    assert Shares.of(2).num_points == flight_page.MAX_POINTS // 2


def test_large_depth_maps_are_made_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures, depth and cameras have one size."""
    monkeypatch.setattr(flight_page, "MAX_SIDE_PX", 24)
    monkeypatch.setattr(flight_page.shown_size, "__defaults__", (24,))
    values = piece_values(piece_of(range(2), *SIZE), frames_of(*SIZE), SIZE, Shares.of(1))
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


def test_a_camera_alone_has_an_overview() -> None:
    """Without points it looks ahead, and odd points do no harm."""
    alone = MapPiece(intrinsics_of(8, 8), {3: pose_at(3)}, np.empty((0, 3)), np.empty((0, 3), np.uint8), {})
    found = overview(alone)
    assert found["radius"] > 0.0
    assert np.isfinite(found["middle"]).all()
    odd = MapPiece(
        intrinsics_of(8, 8), {3: pose_at(3)}, np.full((2, 3), np.nan), np.zeros((2, 3), np.uint8), {}
    )
    assert overview(odd) == found


def test_all_items_are_kept_while_there_is_room() -> None:
    """Nothing is left out below both limits."""
    kept = Thinned[int](100, 10, lambda item: 1)
    for number in range(10):
        kept.offer(lambda number=number: number)  # type: ignore[misc]
    assert kept.items == list(range(10))


def test_what_is_left_is_evenly_spaced_and_within_the_limits() -> None:
    """Items that will not be kept are not made; the first one stays in any case."""
    made = []

    def make(number: int) -> int:
        made.append(number)
        return number

    kept = Thinned[int](70, 100, lambda item: 10)
    for number in range(40):
        kept.offer(lambda number=number: make(number))  # type: ignore[misc]
    assert kept.items == list(range(0, 40, 8))
    assert len(made) < 20
    few = Thinned[int](1, 3, lambda item: 10)
    for number in range(9):
        few.offer(lambda number=number: number)  # type: ignore[misc]
    assert few.items == [0]
