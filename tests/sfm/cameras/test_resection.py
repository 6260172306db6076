"""Cameras from points of the scene and their image positions, despite outliers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.geometry.cameras import project
from sfm.cameras.camera_path import (
    TrackedPoints,
    intermediate_cameras,
    interpolated_camera,
    linear_points,
    linear_tracks,
    tracked_points,
)
from sfm.cameras.resection import (
    Resection,
    ResectionProblem,
    image_distances,
    resection,
    resection_problem,
    robust_weights,
)
from tests.sfm.two_views import FRAME, TwoViews, camera_at, two_views

TIME, SHAKE = 0.4, 0.012


def seen_at(scene: TwoViews, noise_px: float = 0.0, outlier_share: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return where a shaken camera between the key frames sees all points, in pixels."""
    rng = np.random.default_rng(seed)
    exact = FRAME.to_pixels(project(camera_at(TIME, shake=SHAKE), scene.model.points)[0])
    positions = exact + rng.normal(0.0, noise_px, exact.shape)
    outliers = rng.random(len(exact)) < outlier_share
    positions[outliers] += rng.uniform(-20.0, 20.0, (np.count_nonzero(outliers), 2))
    return np.asarray(positions)


def errors_px(scene: TwoViews, camera: np.ndarray) -> np.ndarray:
    """Return how far the camera sees all points of the scene from where they are."""
    offset = FRAME.to_pixels(project(camera, scene.model.points)[0]) - seen_at(scene)
    return np.asarray(np.linalg.norm(offset, axis=1))


def resect(scene: TwoViews, positions: np.ndarray, num: int) -> Resection:
    """Find the camera from the first points, with the usual prior."""
    prior = interpolated_camera(scene.model, TIME)
    return resection(scene.model.points[:num], positions[:num], FRAME, prior)


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize(("num", "bound_px"), [(20, 0.2), (64, 0.02), (2000, 0.002)])
def test_exact_tracks(kind: str, num: int, bound_px: float) -> None:
    """Exact positions give the camera; the pull of the prior fades with the number of points."""
    scene = two_views(2000, kind)  # type: ignore[arg-type]
    found = resect(scene, seen_at(scene), num)
    assert found.success
    assert found.inliers.all()
    assert np.linalg.norm(found.camera) == pytest.approx(np.sqrt(3.0))
    assert np.quantile(errors_px(scene, found.camera), 0.95) < bound_px


@pytest.mark.parametrize(
    ("kind", "outlier_share", "seed"), [("general", 0.0, 0), ("general", 0.2, 1), ("planar", 0.2, 2)]
)
@pytest.mark.parametrize(("num", "bound_px"), [(30, 0.8), (64, 0.5), (400, 0.2)])
def test_noise_and_outliers(kind: str, outlier_share: float, num: int, bound_px: float, seed: int) -> None:
    """Tracks with noise and outliers give the camera to a fraction of the noise, and its error in px."""
    scene = two_views(400, kind, seed=seed)  # type: ignore[arg-type]
    found = resect(scene, seen_at(scene, 0.3, outlier_share, seed), num)
    assert found.success
    assert np.median(errors_px(scene, found.camera)) < bound_px
    assert 0.25 < found.rms_px < 0.55
    assert found.inliers.mean() > 0.8 * (1.0 - outlier_share)


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize("seed", range(4))
def test_six_points_stay_near_the_prior(kind: str, seed: int) -> None:
    """Where points leave the camera open, the prior keeps it sane, where it does not it is left alone."""
    scene = two_views(400, kind, seed=seed)  # type: ignore[arg-type]
    found = resect(scene, seen_at(scene, 0.3, seed=seed), 6)
    before = errors_px(scene, interpolated_camera(scene.model, TIME))
    assert np.median(errors_px(scene, found.camera)) < 0.5 * np.median(before)


def test_points_on_a_line() -> None:
    """Points on a line of the image give a camera that is right there and finite elsewhere."""
    scene = two_views(400)
    order = np.argsort(np.abs(scene.exact.first[:, 1] - 140.0))[:30]
    prior = interpolated_camera(scene.model, TIME)
    found = resection(scene.model.points[order], seen_at(scene)[order], FRAME, prior)
    assert found.success
    assert errors_px(scene, found.camera)[order].max() < 0.5
    assert np.median(errors_px(scene, found.camera)) < 5.0


@pytest.mark.parametrize("num", range(6))
def test_too_few_points(num: int) -> None:
    """With fewer than six points there is a reason, and the prior to go on with."""
    scene = two_views(20)
    found = resect(scene, seen_at(scene), num)
    assert not found.success
    assert str(num) in found.reason
    np.testing.assert_allclose(found.camera, interpolated_camera(scene.model, TIME))
    without = resection(scene.model.points[:num], seen_at(scene)[:num], FRAME)
    np.testing.assert_allclose(without.camera, np.eye(3, 4))


def test_no_prior() -> None:
    """Many points need no prior."""
    scene = two_views(300)
    found = resection(scene.model.points, seen_at(scene, 0.3, 0.1), FRAME)
    assert found.success
    assert np.median(errors_px(scene, found.camera)) < 0.2


def odd_tracks() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return points and positions from which no camera can be told."""
    scene = two_views(40)
    points, seen = scene.model.points, seen_at(scene)
    rng = np.random.default_rng(77)
    return {
        "nan": (points, np.full_like(seen, np.nan)),
        "one place": (points, np.full_like(seen, 5.0)),
        "one point": (np.tile(points[:1], (40, 1)), np.tile(seen[:1], (40, 1))),
        "random": (points, rng.uniform(-1e4, 1e4, seen.shape)),
        "behind": (points * np.array([1.0, 1.0, 1.0, -1.0]), seen),
        "zeros": (np.zeros_like(points), seen),
        "huge": (1e12 * points, 1e12 * seen),
    }


@pytest.mark.parametrize("name", odd_tracks())
def test_odd_inputs_are_values(name: str) -> None:
    """No input raises or warns; the camera is finite, and what cannot be trusted says so."""
    points, seen = odd_tracks()[name]
    for prior in (None, camera_at(TIME)):
        found = resection(points, seen, FRAME, prior)
        assert np.isfinite(found.camera).all()
        assert found.success == (not found.reason)
        if name in {"nan", "random", "zeros"}:
            assert not found.success


def test_shapes_must_agree() -> None:
    """Each point has its position."""
    scene = two_views(20)
    with pytest.raises(ValueError, match="positions"):
        resection(scene.model.points, seen_at(scene)[:-1], FRAME)


@given(st.floats(0.0, 1.0))
def test_linear_tracks_join_the_key_frames(time: float) -> None:
    """(5.8) is the first point at 0, the second at 1, and even between."""
    scene = two_views(10)
    first, second = scene.exact.first, scene.exact.second
    np.testing.assert_array_equal(linear_tracks(first, second, 0.0), first)
    np.testing.assert_array_equal(linear_tracks(first, second, 1.0), second)
    moved = linear_tracks(first, second, time)
    np.testing.assert_allclose(moved - first, time * (second - first), atol=1e-9)


def test_interpolated_cameras_begin_and_end_at_the_key_frames() -> None:
    """At 0 the guess is [I | 0], at 1 the second camera."""
    model = two_views(10).model
    np.testing.assert_allclose(interpolated_camera(model, 0.0), np.eye(3, 4), atol=1e-15)
    np.testing.assert_allclose(interpolated_camera(model, 1.0), model.second_camera, atol=1e-15)


def test_guessed_and_real_tracks_are_interchangeable() -> None:
    """Linear tracks give cameras of the even motion; real ones in their place give the true camera."""
    scene = two_views(120)
    model = scene.model
    guessed = intermediate_cameras(model, [linear_points(model, time) for time in (0.0, TIME, 1.0)])
    assert all(found.success for found in guessed)
    for found, time in zip(guessed, (0.0, TIME, 1.0), strict=True):
        xy = FRAME.to_pixels(project(found.camera, model.points)[0])
        assert np.abs(xy - linear_tracks(scene.exact.first, scene.exact.second, time)).max() < 2.0
    some = np.arange(0, 120, 2)
    real = tracked_points(
        model, scene.exact.first[some], scene.exact.second[some], seen_at(scene)[some], TIME
    )
    (found,) = intermediate_cameras(model, [real])
    assert np.quantile(errors_px(scene, found.camera), 0.95) < 0.1


def test_tracked_points_are_triangulated() -> None:
    """Tracks are placed in the scene of the model; one behind a camera, or that is nan, is not seen."""
    scene = two_views(30)
    second = scene.exact.second.copy()
    second[3] = np.nan
    x = np.append(FRAME.to_normalized(scene.exact.first[4:5]), 1.0)
    behind = scene.camera @ np.append(x, -0.2)
    second[4] = FRAME.to_pixels((behind[:2] / behind[2])[None])[0]
    placed = tracked_points(scene.model, scene.exact.first, second, seen_at(scene), TIME)
    others = np.setdiff1d(np.arange(30), [3, 4])
    np.testing.assert_allclose(placed.points[others], scene.model.points[others], rtol=1e-7)
    assert np.isnan(placed.positions[[3, 4]]).all()
    assert isinstance(placed, TrackedPoints)


IDENTITY = np.hstack([np.eye(3), np.zeros((3, 1))])


def problem_of(num: int) -> ResectionProblem:
    """Return a problem whose camera is the identity, and that has no noise."""
    rng = np.random.default_rng(4)
    x = np.column_stack([rng.uniform(-0.4, 0.4, (num, 2)), np.ones(num), rng.uniform(0.1, 0.4, num)])
    return resection_problem(x, x[:, :2], IDENTITY, FRAME)


def test_weights_fall_with_the_distance_and_end() -> None:
    """Tukey's biweight ends at five and a half standard deviations; Huber's weight never does."""
    problem, num = problem_of(201), 201
    deviations = np.concatenate([np.full(num - 4, 1.1774), [2.75, 5.4, 5.6, 50.0]])
    given = np.concatenate([0.01 * deviations, np.zeros(problem.num_virtual)])
    weights, noise = robust_weights(problem, given, redescending=True)
    assert noise == pytest.approx(0.01, rel=0.02)
    assert weights[num - 4] == pytest.approx((1 - 0.5**2) ** 2, rel=0.02)
    assert weights[num - 3] > 0.0
    assert weights[num - 2] == weights[num - 1] == 0.0
    lasting, _ = robust_weights(problem, given, redescending=False)
    np.testing.assert_allclose(lasting[num - 4 : num], noise / given[num - 4 : num])
    np.testing.assert_allclose(weights[num:], problem.weights[num:] * (noise / problem.sigma) ** 2)


def test_noise_is_never_below_its_bound() -> None:
    """Where all is seen exactly, what is told of the noise is the least that is believed."""
    problem = problem_of(50)
    distances = image_distances(problem, problem.start)
    np.testing.assert_allclose(distances, 0.0, atol=1e-9)
    weights, noise = robust_weights(problem, distances, redescending=True)
    assert noise == problem.min_noise
    np.testing.assert_allclose(weights[:50], 1.0)
