"""Self-calibration and bundle adjustment: bounded depths, the steps of Appendix B, and their minimum."""

from dataclasses import replace

import numpy as np
import pytest

from dvc.geometry.cameras import homogeneous, project
from dvc.geometry.triangulation import inverse_depths, triangulate_depth
from sfm.cameras.camera_pair import (
    BundleAdjustment,
    SelfCalibration,
    SelfCalibrationSettings,
    bundle_adjustment,
    camera_step,
    denominators,
    depth_step,
    self_calibration,
)
from sfm.cameras.projective_basis import camera_basis, camera_from_coordinates, coordinates_of_camera
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels, sampson_distances
from sfm.estimation.weak_calibration import weak_calibration
from sfm.pipeline import AS_WRITTEN
from sfm.scene_model import Correspondences
from tests.reference import sfm_cameras as reference
from tests.sfm.two_views import FRAME, TwoViews, odd_correspondences, two_views


def reprojected_px(found: SelfCalibration, pairs: Correspondences) -> np.ndarray:
    """Project the kept points into the second image, and measure from where they are."""
    points = points_of(FRAME.to_normalized(pairs.first), found.depths)[found.inliers]
    xy, in_second = project(found.camera, points)
    assert (in_second > 0).all()
    return np.linalg.norm(FRAME.to_pixels(xy) - pairs.second[found.inliers], axis=1)


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize("motion", [-1.0, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exact_scenes(kind: str, motion: float, sign: float) -> None:
    """Depths are in [1, M], R is near I, P has norm sqrt(3), and all is consistent with F, of either sign."""
    scene = two_views(100, kind, motion)  # type: ignore[arg-type]
    found = self_calibration(sign * scene.fundamental, scene.exact, FRAME)
    assert not found.reason
    assert found.inliers.all()
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
    assert not found.reason
    assert found.inliers.all()
    assert 1.0 <= found.depths.min() <= found.depths.max() <= found.depth_ratio
    assert np.corrcoef(1.0 / found.depths, 1.0 / scene.depths)[0, 1] > 0.98
    free = self_calibration(scene.fundamental, scene.exact, FRAME)
    assert found.depth_ratio != free.depth_ratio == SelfCalibrationSettings().first_depth_ratio
    behind = scene.exact.second.copy()
    epipole = FRAME.to_pixels(np.asarray(project(scene.camera, np.array([[0.0, 0, 0, 1]]))[0]))[0]
    behind[0] = 2 * epipole - behind[0]
    wrong = replace(scene.exact, second=behind)
    assert not self_calibration(scene.fundamental, wrong, FRAME).reason
    assert self_calibration(scene.fundamental, wrong, FRAME, AS_WRITTEN).reason


def test_depths_keep_their_order_in_noise() -> None:
    scene = two_views(300, noise_px=0.3)
    f = weak_calibration(scene.measured, np.random.default_rng(0)).fundamental
    found = self_calibration(f, scene.measured, FRAME)
    assert not found.reason
    assert found.inliers.mean() > 0.97
    kept = found.inliers
    assert np.corrcoef(1.0 / found.depths[kept], 1.0 / scene.depths[kept])[0, 1] > 0.98
    assert np.median(reprojected_px(found, scene.measured)) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_a_few_bad_points_are_dropped(seed: int) -> None:
    scene = two_views(200, noise_px=0.1, seed=seed)
    bad = np.arange(0, 200, 29)
    second = scene.measured.second.copy()
    step = np.random.default_rng(seed).choice([-1.0, 1.0], len(bad)) * 40.0
    lines = np.column_stack([scene.exact.first[bad], np.ones(len(bad))]) @ scene.fundamental.T
    along = np.column_stack([-lines[:, 1], lines[:, 0]]) / np.linalg.norm(lines[:, :2], axis=1)[:, None]
    second[bad] += step[:, None] * along
    pairs = Correspondences(scene.measured.first, second, np.zeros(200))
    found = self_calibration(scene.fundamental, pairs, FRAME)
    good = found.inliers.copy()
    good[bad] = False
    assert not found.reason
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
    found = self_calibration(scene.fundamental, replace(scene.exact, second=second), FRAME)
    assert "wrong side" in found.reason


@pytest.mark.parametrize(("name", "pairs"), odd_correspondences().items())
def test_odd_inputs_are_values(name: str, pairs: Correspondences) -> None:
    """No input raises or warns; depths and cameras are finite, and impossible inputs give a reason."""
    for f in (np.zeros((3, 3)), np.full((3, 3), np.nan), two_views(10).fundamental):
        found = self_calibration(f, pairs, FRAME)
        assert np.isfinite(found.camera).all()
        assert np.isfinite(found.depths).all()
        assert found.inliers.shape == (len(pairs),)
    adjusted = bundle_adjustment(pairs, found.camera, np.ones(len(pairs)), FRAME, np.random.default_rng(0))
    assert np.isfinite(adjusted.camera).all()
    if name.endswith("points") or name in {"all equal", "nan", "some infinite"}:
        assert adjusted.reason


def test_both_triangulations_agree_on_exact_points() -> None:
    """The linear depths of (5.3) and those nearest in the image are the true ones; infinity is depth inf."""
    scene = two_views(50)
    first, second = normalized(scene.exact)
    linear, in_second = triangulate_depth(first, scene.camera, second)
    inverse, quotient = inverse_depths(first, scene.camera, second)
    np.testing.assert_allclose(linear, scene.depths, rtol=1e-8)
    np.testing.assert_allclose(1.0 / inverse, scene.depths, rtol=1e-8)
    np.testing.assert_allclose(quotient, in_second / linear, rtol=1e-8)
    far = homogeneous(first) @ scene.camera[:, :3].T
    nothing, _ = inverse_depths(first, scene.camera, far[:, :2] / far[:, 2:])
    assert np.abs(nothing).max() < 1e-12


def test_inverse_depth_is_the_nearest_in_the_image() -> None:
    scene = two_views(50, noise_px=2.0)
    first, second = FRAME.to_normalized(scene.exact.first), FRAME.to_normalized(scene.measured.second)
    inverse, _ = inverse_depths(first, scene.camera, second)

    def distance(values: np.ndarray) -> np.ndarray:
        points = np.column_stack([homogeneous(first), values])
        return np.linalg.norm(project(scene.camera, points)[0] - second, axis=1)

    for change in (-1e-3, 1e-3):
        assert (distance(inverse) <= distance(inverse + change)).all()


def start_of(scene: TwoViews, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a camera and depths that are a little off the truth."""
    rng = np.random.default_rng(seed)
    camera = scene.camera + 0.002 * rng.normal(size=(3, 4))
    return camera, scene.depths * np.exp(0.02 * rng.normal(size=len(scene.depths)))


def normalized(pairs: Correspondences, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return points in normalised coordinates, the second ones with noise."""
    first, second = FRAME.to_normalized(pairs.first), FRAME.to_normalized(pairs.second)
    return first, second + np.random.default_rng(1).normal(0.0, noise, second.shape)


def rms_px(found: BundleAdjustment, pairs: Correspondences) -> float:
    """Return the root mean square distance of projected points from those that were seen."""
    return float(np.sqrt(((found.second - pairs.second) ** 2).sum(axis=1).mean()))


def points_of(first: np.ndarray, depths: np.ndarray) -> np.ndarray:
    return np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(first))])


def least_error(scene: TwoViews, start: BundleAdjustment, camera: np.ndarray, depths: np.ndarray) -> float:
    """Minimise the same problem by a general solver; in normalised units."""
    (first, observed), fixed = normalized(scene.measured), start.fixed
    depths = depths.copy()
    depths[fixed] = start.depths[fixed]
    points = points_of(first, depths)[fixed]
    basis = camera_basis(points, project(camera, points)[0])
    return reference.adjust(first, depths, observed[None], camera[None], basis, fixed)


def test_exact_data_have_no_error() -> None:
    """J of (5.6) is 0 at the truth, and the adjustment finds its way back to it."""
    scene = two_views(50)
    first, second = normalized(scene.exact)
    assert reference.reprojection_error(first, scene.depths, second, scene.camera) < 1e-25
    found = bundle_adjustment(scene.exact, scene.camera, start_of(scene)[1], FRAME, np.random.default_rng(0))
    assert rms_px(found, scene.exact) < 1e-9
    np.testing.assert_allclose(found.depths, scene.depths, rtol=1e-6)


def test_steps_are_those_of_the_twin() -> None:
    """The camera of (B.3) is the smallest right singular vector of stacked blocks; depths are of (B.4)."""
    scene = two_views(40)
    first, second = normalized(scene.exact, 1e-3)
    points = scene.model.points
    kappa = denominators(first, scene.depths, scene.camera)
    for basis in (np.eye(12), camera_basis(points[:2], FRAME.to_normalized(scene.exact.second)[:2])):
        found = camera_step(first, scene.depths, second, kappa, basis)
        plain = reference.camera_step(first, scene.depths, second, kappa, basis)
        assert min(np.abs(found - plain).max(), np.abs(found + plain).max()) < 1e-7
        assert (project(found, points)[1] > 0).all()
    depths = depth_step(first, second, scene.camera, kappa)
    np.testing.assert_allclose(depths, reference.depth_step(first, second, scene.camera), rtol=1e-9)


def weighted_error(
    first: np.ndarray, depths: np.ndarray, second: np.ndarray, camera: np.ndarray, kappa: np.ndarray
) -> float:
    """Return the sum of (B.2)."""
    p = points_of(first, depths) @ camera.T
    return float(((kappa[:, None] * (second * p[:, 2:] - p[:, :2])) ** 2).sum())


def test_steps_do_not_increase_the_weighted_error() -> None:
    """For fixed weights both steps only improve (B.2), with fresh ones it is J; fixed points stay exact."""
    scene = two_views(100)
    first, second = normalized(scene.exact, 1e-3)
    second[:2] = FRAME.to_normalized(scene.exact.second)[:2]
    basis = camera_basis(scene.model.points[:2], second[:2])
    camera, depths = scene.camera, scene.depths.copy()
    errors = []
    for _ in range(6):
        kappa = denominators(first, depths, camera)
        before = weighted_error(first, depths, second, camera, kappa)
        assert before == pytest.approx(reference.reprojection_error(first, depths, second, camera), rel=1e-9)
        camera = camera_step(first, depths, second, kappa, basis)
        middle = weighted_error(first, depths, second, camera, kappa)
        moved = depth_step(first, second, camera, kappa)
        depths[2:] = moved[2:]
        after = weighted_error(first, depths, second, camera, kappa)
        assert after <= middle * (1 + 1e-9) <= before * (1 + 1e-9) ** 2
        errors.append(reference.reprojection_error(first, depths, second, camera))
    assert errors[-1] < errors[0] < weighted_error(first, scene.depths, second, scene.camera, kappa)
    assert reference.reprojection_error(first[:2], depths[:2], second[:2], camera) < 1e-20


@pytest.mark.parametrize(
    ("kind", "motion", "noise_px"),
    [("general", 1.0, 0.1), ("general", 0.3, 0.3), ("general", 3.0, 0.5), ("planar", 2.0, 0.1)],
)
def test_the_minimum_is_that_of_a_general_solver(kind: str, motion: float, noise_px: float) -> None:
    scene = two_views(40, kind, motion, noise_px)  # type: ignore[arg-type]
    found = bundle_adjustment(scene.measured, scene.camera, scene.depths, FRAME, np.random.default_rng(0))
    assert not found.reason
    ours = 40.0 * (rms_px(found, scene.measured) / FRAME.scale_px) ** 2
    general = least_error(scene, found, scene.camera, scene.depths)
    assert ours == pytest.approx(general, rel=1e-6)


def test_the_refined_points_obey_the_refined_matrix() -> None:
    scene = two_views(100, noise_px=0.3)
    found = bundle_adjustment(scene.measured, scene.camera, scene.depths, FRAME, np.random.default_rng(0))
    distances = sampson_distances(found.fundamental, scene.measured.first, found.second)
    assert np.abs(distances).max() < 1e-9
    assert found.in_front.all()
    # The adjusted camera is sqrt(3) W r with r of unit norm.
    points = points_of(normalized(scene.measured)[0], found.depths)[found.fixed]
    basis = camera_basis(points, project(scene.camera, points)[0])
    again = camera_from_coordinates(basis, coordinates_of_camera(basis, found.camera))
    np.testing.assert_allclose(again, found.camera, atol=1e-10)


def test_alternation_alone_approaches_the_minimum() -> None:
    scene = two_views(100, noise_px=0.2)
    camera, depths = start_of(scene)
    errors = {}
    for name, alternations, steps in (("none", 0, 0), ("few", 3, 0), ("many", 100, 0), ("joint", 0, 100)):
        rng = np.random.default_rng(0)
        found = bundle_adjustment(scene.measured, camera, depths, FRAME, rng, alternations, steps)
        errors[name] = rms_px(found, scene.measured)
    assert errors["joint"] <= errors["many"] <= errors["few"] <= errors["none"]
    assert errors["many"] < 1.05 * errors["joint"]


def test_depths_must_be_finite_and_one_for_each_point() -> None:
    scene, rng = two_views(20), np.random.default_rng(0)
    depths = scene.depths.copy()
    depths[3] = 0.0
    assert bundle_adjustment(scene.exact, scene.camera, depths, FRAME, rng).reason
    with pytest.raises(ValueError, match="expected"):
        bundle_adjustment(scene.exact, scene.camera, scene.depths[:-1], FRAME, rng)
