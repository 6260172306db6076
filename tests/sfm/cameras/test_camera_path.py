"""Cameras that are found together: smooth paths gain, jerky ones are not harmed much."""

from collections.abc import Callable

import numpy as np
import pytest

from dvc.geometry.cameras import project
from sfm.cameras.camera_path import TrackedPoints, intermediate_cameras, regular_cameras, tracked_points
from sfm.cameras.resection import Resection
from tests.sfm.two_views import FRAME, TwoViews, camera_at, two_views

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
    camera = camera_at(step / NUM_STEPS, shake=shake)
    return np.asarray(FRAME.to_pixels(project(camera, scene.model.points)[0]))


def tracks(scene: TwoViews, shake: Shake, outlier_share: float = 0.0) -> list[TrackedPoints]:
    """Return noisy tracks of all points."""
    rng = np.random.default_rng(3)
    ends = seen(scene, 0), seen(scene, NUM_STEPS)
    instants = []
    for step in range(1, NUM_STEPS):
        positions = seen(scene, step, shake(step)) + rng.normal(0.0, NOISE_PX, ends[0].shape)
        outliers = rng.random(len(positions)) < outlier_share
        positions[outliers] += rng.uniform(-20.0, 20.0, (np.count_nonzero(outliers), 2))
        instants.append(tracked_points(scene.model, *ends, positions, step / NUM_STEPS))
    return instants


def error_px(scene: TwoViews, found: list[Resection], shake: Shake) -> float:
    """Return the root mean square distance of where cameras see the points from where they are."""
    offsets = [
        FRAME.to_pixels(project(resection.camera, scene.model.points)[0]) - seen(scene, step, shake(step))
        for step, resection in enumerate(found, 1)
    ]
    return float(np.sqrt((np.square(offsets).sum(axis=-1)).mean()))


@pytest.mark.parametrize("num", [20, 80])
@pytest.mark.parametrize("outlier_share", [0.0, 0.15])
def test_smooth_path_is_found_better(num: int, outlier_share: float) -> None:
    """On a smooth path the error falls, outliers or not."""
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
        instants = [
            tracked_points(
                scene.model,
                ends[0][kept],
                last[kept],
                seen(scene, step, smooth(step))[kept],
                step / NUM_STEPS,
            )
            for step in range(1, NUM_STEPS)
        ]
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


def test_no_weight_is_no_path() -> None:
    """With weight 0 the cameras are those that are found one by one."""
    scene = two_views(30)
    instants = tracks(scene, smooth)
    pairs = zip(
        regular_cameras(scene.model, instants, 0.0), intermediate_cameras(scene.model, instants), strict=True
    )
    assert all(np.array_equal(a.camera, b.camera) for a, b in pairs)


def test_missing_camera_has_no_part() -> None:
    """Where tracks give no camera the reason stays, and the others are found all the same."""
    scene = two_views(30)
    instants = tracks(scene, smooth)
    lost = np.full_like(instants[2].positions, np.nan)
    instants[2] = TrackedPoints(instants[2].temporal_position, instants[2].points, lost)
    found = regular_cameras(scene.model, instants, 0.1)
    assert [resection.success for resection in found] == [True, True, False, True, True]
    assert found[2].reason


@pytest.mark.parametrize("num", [0, 1, 5, 7])
def test_few_points(num: int) -> None:
    """Any number of points gives one answer for each instant."""
    scene = two_views(30)
    instants = [
        TrackedPoints(instant.temporal_position, instant.points[:num], instant.positions[:num])
        for instant in tracks(scene, smooth)
    ]
    found = regular_cameras(scene.model, instants, 0.1)
    assert len(found) == NUM_STEPS - 1
    assert all(np.isfinite(resection.camera).all() for resection in found)
    assert regular_cameras(scene.model, [], 0.1) == []


@pytest.mark.parametrize("weight", [-0.1, np.nan])
def test_weight_is_checked(weight: float) -> None:
    """A negative weight is no weight."""
    with pytest.raises(ValueError, match="regularity"):
        regular_cameras(two_views(10).model, [], weight)
