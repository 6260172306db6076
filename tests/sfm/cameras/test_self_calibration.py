"""Quasi-Euclidean cameras: depths within bounds, and a second camera near the first."""

from dataclasses import replace

import numpy as np
import pytest

from dvc.geometry.cameras import homogeneous, project
from dvc.geometry.triangulation import inverse_depths, triangulate_depth
from sfm.cameras.self_calibration import SelfCalibration, SelfCalibrationSettings, self_calibration
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels
from sfm.estimation.weak_calibration import weak_calibration
from sfm.pipeline import AS_WRITTEN
from sfm.scene_model import Correspondences
from tests.sfm.two_views import FRAME, odd_correspondences, two_views


def reprojected_px(found: SelfCalibration, pairs: Correspondences) -> np.ndarray:
    """Project the kept points into the second image, and measure from where they are."""
    x = homogeneous(FRAME.to_normalized(pairs.first[found.kept]))
    depths = found.depths[found.kept]
    points = np.column_stack([depths[:, None] * x, np.ones(len(x))])
    xy, in_second = project(found.camera, points)
    assert (in_second > 0).all()
    return np.linalg.norm(FRAME.to_pixels(xy) - pairs.second[found.kept], axis=1)


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize("motion", [-1.0, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exact_scenes(kind: str, motion: float, sign: float) -> None:
    """Depths are in [1, M], R is near I, P has norm sqrt(3), and all is consistent with F, of either sign."""
    scene = two_views(100, kind, motion)  # type: ignore[arg-type]
    found = self_calibration(sign * scene.fundamental, scene.exact, FRAME)
    assert found.success
    assert found.kept.all()
    assert found.depths.min() >= 1.0
    assert found.depths.max() <= found.depth_ratio
    assert reprojected_px(found, scene.exact).max() < 1e-8
    assert np.linalg.norm(found.camera) == pytest.approx(np.sqrt(3.0))
    f = fundamental_to_pixels(fundamental_from_camera(found.camera), FRAME)
    assert min(np.abs(f - scene.fundamental).max(), np.abs(f + scene.fundamental).max()) < 1e-10
    true = scene.camera / np.cbrt(np.linalg.det(scene.camera[:, :3]))
    scaled = found.camera / np.cbrt(np.linalg.det(found.camera[:, :3]))
    identity = np.eye(3)
    assert np.abs(scaled[:, :3] - identity).sum() <= 1.2 * np.abs(true[:, :3] - identity).sum() + 1e-9
    # Nearly Euclidean: inverse depths are nearly in proportion.
    assert np.corrcoef(1.0 / found.depths, 1.0 / scene.depths)[0, 1] > 0.98


def test_as_written_no_point_is_dropped_and_the_unit_is_given() -> None:
    """All depths are in [1, M], M being from their own ratio on; one wrong point leaves no solution."""
    scene = two_views(100)
    found = self_calibration(scene.fundamental, scene.exact, FRAME, AS_WRITTEN)
    assert found.success
    assert found.kept.all()
    assert 1.0 <= found.depths.min() <= found.depths.max() <= found.depth_ratio
    assert np.corrcoef(1.0 / found.depths, 1.0 / scene.depths)[0, 1] > 0.98
    free = self_calibration(scene.fundamental, scene.exact, FRAME)
    assert found.depth_ratio != free.depth_ratio == SelfCalibrationSettings().first_depth_ratio
    behind = scene.exact.second.copy()
    epipole = FRAME.to_pixels(np.asarray(project(scene.camera, np.array([[0.0, 0, 0, 1]]))[0]))[0]
    behind[0] = 2 * epipole - behind[0]
    wrong = replace(scene.exact, second=behind)
    assert self_calibration(scene.fundamental, wrong, FRAME).success
    assert not self_calibration(scene.fundamental, wrong, FRAME, AS_WRITTEN).success


def test_depths_keep_their_order_in_noise() -> None:
    """Noise of a few tenths of a pixel leaves near points near and far points far."""
    scene = two_views(300, noise_px=0.3)
    f = weak_calibration(scene.measured, np.random.default_rng(0)).fundamental
    found = self_calibration(f, scene.measured, FRAME)
    assert found.success
    assert found.kept.mean() > 0.97
    kept = found.kept
    assert np.corrcoef(1.0 / found.depths[kept], 1.0 / scene.depths[kept])[0, 1] > 0.98
    assert np.median(reprojected_px(found, scene.measured)) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_a_few_bad_points_are_dropped(seed: int) -> None:
    """Wrong depths of a few points neither prevent nor bend the solution."""
    scene = two_views(200, noise_px=0.1, seed=seed)
    bad = np.arange(0, 200, 29)
    second = scene.measured.second.copy()
    step = np.random.default_rng(seed).choice([-1.0, 1.0], len(bad)) * 40.0
    lines = np.column_stack([scene.exact.first[bad], np.ones(len(bad))]) @ scene.fundamental.T
    along = np.column_stack([-lines[:, 1], lines[:, 0]]) / np.linalg.norm(lines[:, :2], axis=1)[:, None]
    second[bad] += step[:, None] * along
    pairs = Correspondences(scene.measured.first, second, np.zeros(200))
    found = self_calibration(scene.fundamental, pairs, FRAME)
    good = found.kept.copy()
    good[bad] = False
    assert found.success
    assert np.count_nonzero(good) >= 190
    assert np.corrcoef(1.0 / found.depths[good], 1.0 / scene.depths[good])[0, 1] > 0.95


def test_points_behind_a_camera_fail_with_a_reason() -> None:
    """If half of the points contradict the chirality of the others there is no solution, and a reason."""
    scene = two_views(100)
    second = scene.exact.second.copy()
    x = homogeneous(FRAME.to_normalized(scene.exact.first))
    before = x @ scene.camera[2, :3]
    points = np.column_stack([x, -2.0 * before / scene.camera[2, 3]])[::2]
    second[::2] = FRAME.to_pixels(project(scene.camera, points)[0])
    found = self_calibration(
        scene.fundamental, Correspondences(scene.exact.first, second, np.zeros(100)), FRAME
    )
    assert not found.success
    assert "wrong side" in found.reason


@pytest.mark.parametrize(("name", "pairs"), odd_correspondences().items())
def test_odd_inputs_are_values(name: str, pairs: Correspondences) -> None:
    """No input raises or warns; depths and cameras are finite, and a failure says why."""
    del name
    for f in (np.zeros((3, 3)), np.full((3, 3), np.nan), two_views(10).fundamental):
        found = self_calibration(f, pairs, FRAME)
        assert np.isfinite(found.camera).all()
        assert np.isfinite(found.depths).all()
        assert found.success == (not found.reason)
        assert found.kept.shape == (len(pairs),)


def test_both_triangulations_agree_on_exact_points() -> None:
    """The linear depths of (5.3) and those nearest in the image are the true ones; infinity is depth inf."""
    scene = two_views(50)
    first, second = FRAME.to_normalized(scene.exact.first), FRAME.to_normalized(scene.exact.second)
    linear, in_second = triangulate_depth(first, scene.camera, second)
    inverse, quotient = inverse_depths(first, scene.camera, second)
    np.testing.assert_allclose(linear, scene.depths, rtol=1e-8)
    np.testing.assert_allclose(1.0 / inverse, scene.depths, rtol=1e-8)
    np.testing.assert_allclose(quotient, in_second / linear, rtol=1e-8)
    far = homogeneous(first) @ scene.camera[:, :3].T
    nothing, _ = inverse_depths(first, scene.camera, far[:, :2] / far[:, 2:])
    assert np.abs(nothing).max() < 1e-12


def test_inverse_depth_is_the_nearest_in_the_image() -> None:
    """No other depth projects nearer to the point that was seen."""
    scene = two_views(50, noise_px=2.0)
    first, second = FRAME.to_normalized(scene.exact.first), FRAME.to_normalized(scene.measured.second)
    inverse, _ = inverse_depths(first, scene.camera, second)

    def distance(values: np.ndarray) -> np.ndarray:
        points = np.column_stack([homogeneous(first), values])
        return np.linalg.norm(project(scene.camera, points)[0] - second, axis=1)

    for change in (-1e-3, 1e-3):
        assert (distance(inverse) <= distance(inverse + change)).all()
