"""Cameras from points of the scene and their positions, despite outliers: each, or along a smooth path."""

from collections.abc import Callable

import numpy as np
import pytest

from dvc.geometry.cameras import project
from sfm.cameras.camera_path import (
    Resection,
    ResectionProblem,
    TrackedPoints,
    image_distances,
    intermediate_cameras,
    interpolated_camera,
    linear_points,
    regular_cameras,
    resection,
    resection_problem,
    robust_weights,
    tracked_points,
)
from tests.sfm.two_views import FRAME, TwoViews, camera_at, two_views

TIME, SHAKE = 0.4, 0.012


def seen_at(
    scene: TwoViews,
    noise_px: float = 0.0,
    outlier_share: float = 0.0,
    seed: int = 0,
    time: float = TIME,
    shake: float = SHAKE,
) -> np.ndarray:
    """Return where a shaken camera between the key frames sees all points, in pixels."""
    rng = np.random.default_rng(seed)
    exact = FRAME.to_pixels(project(camera_at(time, shake=shake), scene.model.points)[0])
    positions = exact + rng.normal(0.0, noise_px, exact.shape)
    outliers = rng.random(len(exact)) < outlier_share
    positions[outliers] += rng.uniform(-20.0, 20.0, (np.count_nonzero(outliers), 2))
    return np.asarray(positions)


def errors_px(scene: TwoViews, camera: np.ndarray, time: float = TIME, shake: float = SHAKE) -> np.ndarray:
    """Return how far the camera sees all points of the scene from where they are."""
    exact = seen_at(scene, time=time, shake=shake)
    offset = FRAME.to_pixels(project(camera, scene.model.points)[0]) - exact
    return np.asarray(np.linalg.norm(offset, axis=1))


def resect(scene: TwoViews, positions: np.ndarray, num: int) -> Resection:
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
    if num == 400:  # many points need no prior
        without = resection(scene.model.points, seen_at(scene, 0.3, outlier_share, seed), FRAME)
        assert np.median(errors_px(scene, without.camera)) < bound_px


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize("seed", range(4))
def test_six_points_stay_near_the_prior(kind: str, seed: int) -> None:
    """Where points leave the camera open, the prior keeps it sane, where it does not it is left alone."""
    scene = two_views(400, kind, seed=seed)  # type: ignore[arg-type]
    found = resect(scene, seen_at(scene, 0.3, seed=seed), 6)
    before = errors_px(scene, interpolated_camera(scene.model, TIME))
    assert np.median(errors_px(scene, found.camera)) < 0.5 * np.median(before)


def test_points_on_a_line() -> None:
    scene = two_views(400)
    order = np.argsort(np.abs(scene.exact.first[:, 1] - 140.0))[:30]
    prior = interpolated_camera(scene.model, TIME)
    found = resection(scene.model.points[order], seen_at(scene)[order], FRAME, prior)
    assert found.success
    assert errors_px(scene, found.camera)[order].max() < 0.5
    assert np.median(errors_px(scene, found.camera)) < 5.0


@pytest.mark.parametrize("num", range(6))
def test_too_few_points(num: int) -> None:
    scene = two_views(20)
    found = resect(scene, seen_at(scene), num)
    assert not found.success
    assert str(num) in found.reason
    np.testing.assert_allclose(found.camera, interpolated_camera(scene.model, TIME))
    without = resection(scene.model.points[:num], seen_at(scene)[:num], FRAME)
    np.testing.assert_allclose(without.camera, np.eye(3, 4))
    with pytest.raises(ValueError, match="positions"):
        resection(scene.model.points, seen_at(scene)[:-1], FRAME)


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
    points, seen = odd_tracks()[name]
    for prior in (None, camera_at(TIME)):
        found = resection(points, seen, FRAME, prior)
        assert np.isfinite(found.camera).all()
        if name in {"nan", "random", "zeros"}:
            assert not found.success


def test_cameras_and_linear_tracks_begin_and_end_at_the_key_frames() -> None:
    """At 0 the guess is [I | 0], at 1 the second camera; points of (5.8) move evenly."""
    model = two_views(10).model
    ends = model.correspondences.first, model.correspondences.second
    for time in (0.0, 0.3, 1.0):
        moved = linear_points(model, time).positions - ends[0]
        np.testing.assert_allclose(moved, time * (ends[1] - ends[0]), atol=1e-9)
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
        assert np.abs(xy - linear_points(model, time).positions).max() < 2.0
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


def problem_of(num: int) -> ResectionProblem:
    """Return a problem whose camera is the identity, and that has no noise."""
    rng = np.random.default_rng(4)
    x = np.column_stack([rng.uniform(-0.4, 0.4, (num, 2)), np.ones(num), rng.uniform(0.1, 0.4, num)])
    return resection_problem(x, x[:, :2], np.eye(3, 4), FRAME)


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


NUM_STEPS = 6
NOISE_PX = 0.5
JERKS = np.random.default_rng(5).normal(0.0, 0.012, NUM_STEPS + 1)

Shake = Callable[[int], float]


def smooth(step: int) -> float:
    return float(0.01 * np.sin(np.pi * step / NUM_STEPS))


def jerky(step: int) -> float:
    return float(JERKS[step])


def seen(scene: TwoViews, step: int, shake: float = 0.0) -> np.ndarray:
    """Return where all points are in a frame, in pixels."""
    return seen_at(scene, time=step / NUM_STEPS, shake=shake)


def tracks(scene: TwoViews, shake: Shake, outlier_share: float = 0.0) -> list[TrackedPoints]:
    ends, instants = (seen(scene, 0), seen(scene, NUM_STEPS)), []
    for step in range(1, NUM_STEPS):
        time = step / NUM_STEPS
        positions = seen_at(scene, NOISE_PX, outlier_share, 3 + step, time, shake(step))
        instants.append(tracked_points(scene.model, *ends, positions, time))
    return instants


def error_px(scene: TwoViews, found: list[Resection], shake: Shake) -> float:
    """Return the root mean square distance of where cameras see the points from where they are."""
    times = [(step / NUM_STEPS, shake(step)) for step in range(1, NUM_STEPS)]
    errors = [errors_px(scene, each.camera, *time) for each, time in zip(found, times, strict=True)]
    return float(np.sqrt(np.square(errors).mean()))


@pytest.mark.parametrize("num", [20, 80])
@pytest.mark.parametrize("outlier_share", [0.0, 0.15])
def test_smooth_path_is_found_better(num: int, outlier_share: float) -> None:
    scene = two_views(num, seed=1)
    instants = tracks(scene, smooth, outlier_share)
    alone, together = (error_px(scene, regular_cameras(scene.model, instants, w), smooth) for w in (0.0, 0.1))
    assert together < 0.9 * alone


def test_tracks_that_end_have_no_part_in_the_path() -> None:
    """Points that are not known in both key frames change no camera, wherever they are elsewhere."""
    scene = two_views(60, seed=1)
    ends = seen(scene, 0), seen(scene, NUM_STEPS)
    lost = ends[1].copy()
    lost[::3] = np.nan
    found = []
    for kept, last in ((np.arange(60) % 3 > 0, ends[1]), (np.ones(60, np.bool_), lost)):
        instants = []
        for step in range(1, NUM_STEPS):
            positions = seen(scene, step, smooth(step))[kept]
            tracked = tracked_points(scene.model, ends[0][kept], last[kept], positions, step / NUM_STEPS)
            instants.append(tracked)
        found.append(regular_cameras(scene.model, instants, 0.1))
    for alone, among in zip(*found, strict=True):
        np.testing.assert_allclose(among.camera, alone.camera, atol=1e-12)


def test_jerky_path_is_hardly_harmed_by_a_moderate_weight() -> None:
    """Jerks of many pixels cost little of the error that noise makes, nor much with a large weight."""
    scene = two_views(40, seed=2)
    instants = tracks(scene, jerky)
    alone, moderate, large = (
        error_px(scene, regular_cameras(scene.model, instants, w), jerky) for w in (0.0, 0.03, 0.1)
    )
    assert moderate < 1.15 * alone
    assert large < 2.0 * alone


def test_missing_camera_has_no_part() -> None:
    """Where tracks give no camera the reason stays, and the others are found all the same."""
    scene = two_views(30)
    instants = tracks(scene, smooth)
    lost = np.full_like(instants[2].positions, np.nan)
    instants[2] = TrackedPoints(instants[2].temporal_position, instants[2].points, lost)
    found = regular_cameras(scene.model, instants, 0.1)
    assert [each.success for each in found] == [True, True, False, True, True]
    assert found[2].reason
    # With weight 0 the cameras are those of each instant.
    pairs = zip(
        regular_cameras(scene.model, instants, 0.0), intermediate_cameras(scene.model, instants), strict=True
    )
    assert all(np.array_equal(a.camera, b.camera) for a, b in pairs)


@pytest.mark.parametrize("num", [0, 1, 5, 7])
def test_few_points(num: int) -> None:
    scene = two_views(30)
    instants = [
        TrackedPoints(instant.temporal_position, instant.points[:num], instant.positions[:num])
        for instant in tracks(scene, smooth)
    ]
    found = regular_cameras(scene.model, instants, 0.1)
    assert len(found) == NUM_STEPS - 1
    assert all(np.isfinite(each.camera).all() for each in found)
    assert regular_cameras(scene.model, [], 0.1) == []
    for weight in (-0.1, np.nan):
        with pytest.raises(ValueError, match="regularity"):
            regular_cameras(scene.model, [], weight)
