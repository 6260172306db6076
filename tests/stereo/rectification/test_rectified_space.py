"""The rectified space: identities (2.4) to (2.12) on random rigs, and rectified pictures."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.rectification.rectified_array import rectify
from dvc.stereo.rectification.rectified_space import (
    MAX_GROWTH,
    Rectification,
    metric_depth,
    to_original_view,
)
from tests.stereo.rigs import pixels_of, random_rig, rays_of

PLACES = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]
LINE = [(0.0, 0.0), (1.0, 0.0), (3.0, 0.0)]
seeds = st.integers(0, 10**6)
rigs = st.sampled_from([PLACES, LINE, PLACES[:2], PLACES[::3]])


def points_before(rig: list[Camera], seed: int, unit: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    forward = np.mean([camera.R[2] for camera in rig], axis=0)
    middle = np.mean([camera.centre for camera in rig], axis=0)
    return middle + unit * (rng.uniform(8, 20, (30, 1)) * forward + rng.normal(size=(30, 3)))


def rectified_projection(position: LatticePosition) -> np.ndarray:
    """Return the projection from the rectified space to a picture (2.4)."""
    m, n = position
    return np.array([[1.0, 0, -m, 0], [0, 1.0, -n, 0], [0, 0, 0, 1.0]])


def seen(projection: np.ndarray, points: np.ndarray) -> np.ndarray:
    image = points @ projection[:, :-1].T + projection[:, -1]
    return image[:, :2] / image[:, 2:]


@settings(max_examples=50)
@given(seeds, rigs)
def test_matrix_identity(seed: int, places: list) -> None:
    """(2.10): both sides are equal as matrices, not only up to scale."""
    rig = random_rig(seed, places)
    found = replace(rectify(rig), middle_disparity=0.0, offset=(0.0, 0.0), disparity_shift=0.0)
    for index, (camera, position) in enumerate(zip(rig, found.positions, strict=True)):
        left = found.rectified_from_view(index) @ camera.projection
        right = rectified_projection(position) @ found.rectified_from_world
        np.testing.assert_allclose(left, right, atol=1e-10 * np.abs(right).max())


@settings(max_examples=50)
@given(seeds, rigs, st.sampled_from([0.01, 1.0, 250.0]))
def test_points_obey_the_rectified_projection(seed: int, places: list, unit: float) -> None:
    """(2.5), (2.12): (x, y, d) gives the position of a point in each view, with the offset of the crop."""
    rig = random_rig(seed, places, unit)
    found = rectify(rig)
    points = points_before(rig, seed, unit)
    space = np.column_stack([points, np.ones(len(points))]) @ found.rectified_from_world.T
    x, y, d = (space[:, k] / space[:, 3] for k in range(3))
    np.testing.assert_allclose(found.disparities(points), d, atol=1e-9)
    for index, (camera, (m, n)) in enumerate(zip(rig, found.positions, strict=True)):
        rectified = found.rectified_points(index, seen(camera.projection, points))
        np.testing.assert_allclose(rectified, np.column_stack([x - m * d, y - n * d]), atol=1e-8)
    back = np.column_stack([x, y, d, np.ones(len(x))]) @ found.world_from_rectified.T
    np.testing.assert_allclose(back[:, :3] / back[:, 3:], points, atol=1e-9 * max(1.0, np.abs(points).max()))


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
def test_pixels_keep_their_size(unit: float) -> None:
    """The area magnification on the normal is 1 for cameras of the mean focal length, in any unit."""
    K = np.array([[150.0, 0, 80.0], [0, 150.0, 60.0], [0, 0, 1.0]])
    rig = [Camera(c.name, K, c.R, c.t, c.size) for c in random_rig(4, PLACES, unit, turn=0.0)]
    found = rectify(rig)
    homography = found.rectified_from_view(0)
    corners = np.array([[80.0, 60.0], [81.0, 60.0], [80.0, 61.0]])
    image = np.column_stack([corners, np.ones(3)]) @ homography.T
    a, b = (image[1:, :2] / image[1:, 2:]) - image[0, :2] / image[0, 2]
    assert abs(a[0] * b[1] - a[1] * b[0]) == pytest.approx(1.0, rel=1e-6)


def test_depth_of_original_views_is_that_of_the_plane() -> None:
    """A slanted plane's exact rectified disparity gives its exact depth in every original, distorted view."""
    rig = random_rig(12, PLACES, turn=0.05)
    rig = [Camera(c.name, c.K, c.R, c.t, c.size, (0.05, -0.01, 0.002, 0.001)) for c in rig]
    found = rectify(rig)
    normal = np.mean([camera.R[2] for camera in rig], axis=0) + 0.1 * rig[0].R[0]
    offset = float(normal @ found.lattice.origin) + 9.0
    world = found.world_from_rectified
    for index, camera in enumerate(rig):
        # normal . X = offset is linear in (x, y, d, 1).
        plane = np.append(normal, -offset) @ world
        m, n = found.positions[index]
        y, x = np.mgrid[: found.size[1], : found.size[0]].astype(np.float64)
        d = -(plane[0] * x + plane[1] * y + plane[3]) / (plane[0] * m + plane[1] * n + plane[2])
        disparity = to_original_view(found, index, d.astype(np.float32))
        depth = metric_depth(found, index, disparity)
        true = ((offset - normal @ camera.centre) / (rays_of(camera) @ normal)).reshape(depth.shape)
        inside = found.rectified_points(index, pixels_of(camera.size))
        kept = ((inside > 1) & (inside < np.array(found.size) - 2)).all(axis=1).reshape(depth.shape)
        assert kept.mean() > 0.95
        np.testing.assert_allclose(depth[kept], true[kept], rtol=2e-4)


def test_discontinuities_stay_sharp_in_original_views() -> None:
    rig = random_rig(13, PLACES[:2], turn=0.1)
    found = rectify(rig)
    plane = np.full(found.size[::-1], 3.0, np.float32)
    plane[:, found.size[0] // 2 :] = 9.0
    assert set(np.unique(to_original_view(found, 0, plane))) == {3.0, 9.0}


def test_infinity_has_infinite_depth() -> None:
    found = rectify(random_rig(14, PLACES[:2], turn=0.02))
    flat = np.full((120, 160), -found.disparity_shift - 1.0, np.float32)
    assert np.isinf(metric_depth(found, 0, flat)).all()


def test_centres_off_the_plane_are_reported_in_pixels() -> None:
    """The bound on the error of (2.5) holds at both ends of the range of disparities."""
    rig = random_rig(15, PLACES, turn=0.02)
    bent = rig[4]
    rig[4] = Camera(bent.name, bent.K, bent.R, bent.t + np.array([0, 0, 0.3]), bent.size)
    points = points_before(rig, 15)
    found = rectify(rig, [LatticePosition(*place) for place in PLACES], points)
    d = found.disparities(points)
    bound_px = found.off_plane_px(d.min(), d.max())
    space = np.column_stack([points, np.ones(len(points))]) @ found.rectified_from_world.T
    xy = space[:, :2] / space[:, 3:]
    missed = []
    for index, camera in enumerate(rig):
        place = found.rectified_points(index, seen(camera.projection, points))
        missed.append(np.linalg.norm(place - (xy - np.outer(d, found.positions[index])), axis=1).max())
    assert max(missed) > 0.05
    assert np.all(missed <= bound_px * 1.05 + 1e-6)


def kept_share(found: Rectification, index: int) -> float:
    """Return which share of a picture's pixels its rectified one holds."""
    place = found.rectified_points(index, pixels_of(found.cameras[index].size))
    return float(((place > -1e-3) & (place < np.array(found.size) - 1 + 1e-3)).all(axis=1).mean())


def test_window_holds_pictures_that_fit() -> None:
    """Cameras that hardly turn: all corners are in the window, in the scale of the pictures."""
    rig = [replace(camera, K=random_rig(16, PLACES)[0].K) for camera in random_rig(16, PLACES, turn=0.01)]
    found = rectify(rig)
    assert found.focal_length_px == pytest.approx(rig[0].focal_length_px)
    for index in range(len(PLACES)):
        border = found.border(index)
        assert border.min() > -1e-3
        assert (border <= np.array(found.size) - 1 + 1e-2).all()


@pytest.mark.parametrize("turn_deg", [(0.0, 45.0, 0.0), (0.0, 20.0, 40.0), (15.0, -30.0, 0.0)])
def test_rectified_pictures_are_about_as_large_as_the_originals(turn_deg: tuple[float, float, float]) -> None:
    """Two cameras far from parallel to their plane: not many more pixels, of nearly all that they see."""
    K = np.array([[140.0, 0.0, 79.5], [0.0, 140.0, 59.5], [0.0, 0.0, 1.0]])
    R = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    rig = [Camera(f"{m}.png", K, R, -R @ np.array([m, 0.0, 0.0]), (160, 120)) for m in (0.0, 1.0)]
    found = rectify(rig)
    width, height = found.size
    assert width * height <= MAX_GROWTH * 160 * 120 + 2 * (width + height)
    assert width * height > 0.9 * 160 * 120
    assert 0.3 * 140.0 < found.focal_length_px <= 140.0
    for index in range(2):
        assert kept_share(found, index) > 0.93
    points = np.array([[0.3, -0.2, 4.0], [1.0, 0.5, 9.0]]) @ R
    places = [found.rectified_points(k, seen(rig[k].projection, points)) for k in range(2)]
    parallax = np.outer(found.disparities(points), [1.0, 0.0])
    np.testing.assert_allclose(places[0] - places[1], parallax, atol=1e-6)


def test_camera_that_looks_along_the_plane_is_refused() -> None:
    rig = random_rig(18, PLACES, turn=0.01)
    turn = np.array([[0.0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]])
    rig[2] = Camera(rig[2].name, rig[2].K, turn @ rig[2].R, turn @ rig[2].t, rig[2].size)
    with pytest.raises(ConfigError, match=r"view2\.png.*along the plane"):
        rectify(rig)


def test_one_camera_and_two_at_one_place_are_refused() -> None:
    rig = random_rig(19, [(0.0, 0.0), (1.0, 0.0), (0.0, 0.0)], turn=0.02)
    with pytest.raises(ConfigError, match="at least two"):
        rectify(rig[:1])
    with pytest.raises(ConfigError, match=r"view0\.png and view2\.png"):
        rectify(rig)
