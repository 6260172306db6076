"""Truth of the rendered scenes: depth, correspondences, occlusion and motion agree with the pictures."""

import numpy as np
import pytest

from sequences.rendered_scenes import Scene, render_frame, scene
from sequences.scene_cameras import back_project, project
from sequences.true_correspondences import correspondences, depth_at, in_image, pixel_grid
from tests.reference.epipolar import fundamental_matrix

SIZE = (88, 72)


@pytest.fixture(params=("street", "stairway", "statue"))
def any_scene(request: pytest.FixtureRequest) -> Scene:
    return scene(request.param)


def test_depth_map_is_the_depth_of_a_ray_through_the_pixel_centre(any_scene: Scene) -> None:
    rendered = render_frame(any_scene, 3, *SIZE)
    cast, _ = depth_at(any_scene, rendered.camera, pixel_grid(*SIZE))
    assert rendered.depth.dtype == np.float32
    np.testing.assert_allclose(rendered.depth.ravel(), cast, rtol=1e-5)


def test_correspondences_satisfy_the_epipolar_constraint(any_scene: Scene) -> None:
    pairs = correspondences(any_scene, 0, 5, None, *SIZE)
    near = np.isfinite(pairs.depth_a) & np.isfinite(pairs.points_b).all(axis=1)
    a, b = any_scene.camera(0, *SIZE), any_scene.camera(5, *SIZE)
    ones = np.ones((near.sum(), 1))
    lines = np.hstack([pairs.points_a[near], ones]) @ fundamental_matrix(a, b).T
    distance = np.abs((np.hstack([pairs.points_b[near], ones]) * lines).sum(axis=1))
    assert near.sum() > 3000
    assert (distance / np.hypot(lines[:, 0], lines[:, 1])).max() < 1e-6


def test_reprojected_depth_agrees_with_the_other_frame(any_scene: Scene) -> None:
    """The depth map of one frame, moved to another, agrees with the depth of visible points there."""
    a, b = render_frame(any_scene, 0, *SIZE, samples=1), render_frame(any_scene, 2, *SIZE, samples=1)
    pairs = correspondences(any_scene, 0, 2, None, *SIZE)
    use = pairs.visible & np.isfinite(pairs.depth_a)
    points = back_project(a.camera, pairs.points_a[use], a.depth.ravel()[use].astype(np.float64))
    xy, depth = project(b.camera, points)
    np.testing.assert_allclose(xy, pairs.points_b[use], atol=1e-3)
    column, row = np.clip(np.rint(xy).astype(int), 0, np.array(SIZE) - 1).T
    ratio = b.depth[row, column] / depth
    assert np.mean(np.abs(ratio - 1) < 0.05) > 0.85


def test_luma_of_visible_points_agrees_between_frames(any_scene: Scene) -> None:
    a, b = render_frame(any_scene, 0, *SIZE), render_frame(any_scene, 2, *SIZE)
    pairs = correspondences(any_scene, 0, 2, None, *SIZE)
    luma_a, luma_b = a.frame.luma.astype(float).ravel(), b.frame.luma.astype(float)
    x, y = (np.clip(pairs.points_b[:, i], 0, SIZE[i] - 1.001) for i in (0, 1))
    x, y = np.nan_to_num(x), np.nan_to_num(y)
    i, j = y.astype(int), x.astype(int)
    v, u = y - i, x - j
    warped = (1 - v) * ((1 - u) * luma_b[i, j] + u * luma_b[i, j + 1])
    warped += v * ((1 - u) * luma_b[i + 1, j] + u * luma_b[i + 1, j + 1])
    error = np.abs(warped - luma_a)[pairs.visible]
    still = np.abs(luma_b.ravel() - luma_a)[pairs.visible]
    assert pairs.visible.mean() > 0.75
    assert np.median(error) < 3.0
    assert error.mean() < 0.5 * still.mean()


def test_points_may_lie_between_pixels_and_outside(any_scene: Scene) -> None:
    """A fractional point is followed; one outside the image has no depth and is not visible."""
    points = np.array([[30.25, 50.75], [-5.0, 10.0], [87.5, 71.5]])
    pairs = correspondences(any_scene, 0, 1, points, *SIZE)
    assert np.isfinite(pairs.points_b[0]).all()
    assert np.isnan(pairs.depth_a[1])
    assert not pairs.visible[1]
    assert not np.isnan(pairs.depth_a[2])
    # From a frame to itself every point stays and is visible.
    pairs = correspondences(any_scene, 4, 4, None, *SIZE)
    np.testing.assert_allclose(pairs.points_b, pairs.points_a, atol=1e-7)
    assert pairs.visible.mean() > 0.995
    with pytest.raises(ValueError, match=r"`points`.*\(3,\)"):
        correspondences(any_scene, 0, 1, np.zeros(3))


def test_epipole_of_street_lies_inside_the_image() -> None:
    street = scene("street")
    for first, second in ((0, 1), (0, 10), (20, 30), (39, 49)):
        a, b = street.camera(first), street.camera(second)
        epipole, depth = project(a, b.centre[None])
        assert depth[0] > 0.1
        assert (np.abs(epipole[0] - (175.5, 143.5)) < (120, 100)).all()


def test_stairway_trembles_within_seven_pixels() -> None:
    """No visible point moves more than 7 px between frames; the motion is lateral but far from even."""
    stairway = scene("stairway")
    grid = pixel_grid(352, 288, 16)
    longest, vertical = [], []
    for index in range(49):
        pairs = correspondences(stairway, index, index + 1, grid)
        motion = (pairs.points_b - pairs.points_a)[pairs.visible]
        longest.append(np.linalg.norm(motion, axis=1).max())
        vertical.append(np.median(motion[:, 1]))
    assert 3.5 < max(longest) <= 7.0
    assert min(longest) < 0.6 * max(longest)
    assert np.std(vertical) > 0.2


def test_statue_hides_much_of_the_square() -> None:
    """Over ten frames several percent of the image are hidden, most of them next to the figure."""
    statue = scene("statue")
    pairs = correspondences(statue, 10, 20, pixel_grid(352, 288, 3))
    inside = in_image(statue.camera(20), pairs.points_b)
    hidden = inside & ~pairs.visible
    assert 0.03 < hidden.sum() / inside.sum() < 0.3
    beyond = pairs.depth_a[hidden] > 7.0
    assert beyond.mean() > 0.7


def test_sky_is_infinitely_far_and_turns_with_the_camera() -> None:
    street = scene("street")
    pairs = correspondences(street, 0, 5, None, *SIZE)
    sky = np.isinf(pairs.depth_a)
    assert 0.03 < sky.mean() < 0.4
    assert pairs.visible[sky].mean() > 0.8
    a, b = street.camera(0, *SIZE), street.camera(5, *SIZE)
    turn = b.K @ b.cam_from_world[:, :3] @ a.cam_from_world[:, :3].T @ np.linalg.inv(a.K)
    moved = np.hstack([pairs.points_a[sky], np.ones((sky.sum(), 1))]) @ turn.T
    np.testing.assert_allclose(moved[:, :2] / moved[:, 2:], pairs.points_b[sky], atol=1e-9)
