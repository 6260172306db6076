"""Bundle adjustment: the steps of Appendix B, and the minimum that they lead to."""

import numpy as np
import pytest

from dvc.geometry.cameras import project
from sfm.cameras.bundle_adjustment import (
    BundleAdjustment,
    bundle_adjustment,
    camera_step,
    denominators,
    depth_step,
)
from sfm.cameras.projective_basis import camera_basis, camera_from_coordinates, coordinates_of_camera
from sfm.estimation.epipolar import sampson_distances
from sfm.scene_model import Correspondences
from tests.reference import sfm_cameras as reference
from tests.sfm.two_views import FRAME, TwoViews, camera_at, odd_correspondences, two_views


def start_of(scene: TwoViews, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a camera and depths that are a little off the truth."""
    rng = np.random.default_rng(seed)
    camera = scene.camera + 0.002 * rng.normal(size=(3, 4))
    return camera, scene.depths * np.exp(0.02 * rng.normal(size=len(scene.depths)))


def noisy_second(scene: TwoViews, noise: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return exact first and noisy second points in normalised coordinates."""
    first, second = FRAME.to_normalized(scene.exact.first), FRAME.to_normalized(scene.exact.second)
    return first, second + np.random.default_rng(1).normal(0.0, noise, second.shape)


def least_error(scene: TwoViews, start: BundleAdjustment, camera: np.ndarray, depths: np.ndarray) -> float:
    """Minimise the same problem by a general solver; in normalised units."""
    first = FRAME.to_normalized(scene.measured.first)
    observed = FRAME.to_normalized(scene.measured.second)[None]
    fixed = start.fixed
    depths = depths.copy()
    depths[fixed] = start.depths[fixed]
    points = np.column_stack(
        [depths[:, None] * np.column_stack([first, np.ones(len(first))]), np.ones(len(first))]
    )
    basis = camera_basis(points[fixed], project(camera, points[fixed])[0])
    return reference.adjust(first, depths, observed, camera[None], basis, fixed)


def test_exact_data_have_no_error() -> None:
    """J of (5.6) is 0 at the truth, and the adjustment finds its way back to it."""
    scene = two_views(50)
    camera, depths = start_of(scene)
    first, second = FRAME.to_normalized(scene.exact.first), FRAME.to_normalized(scene.exact.second)
    assert reference.reprojection_error(first, scene.depths, second, scene.camera) < 1e-25
    found = bundle_adjustment(scene.exact, scene.camera, depths, FRAME, np.random.default_rng(0))
    assert found.success
    assert found.start_rms_px > 0.1
    assert found.rms_px < 1e-9
    np.testing.assert_allclose(found.depths, scene.depths, rtol=1e-6)
    rough = bundle_adjustment(scene.exact, camera, depths, FRAME, np.random.default_rng(0))
    assert rough.rms_px < rough.start_rms_px


def test_camera_step_is_that_of_the_twin() -> None:
    """The camera of (B.3) is the smallest right singular vector of the stacked blocks, up to its sign."""
    scene = two_views(40)
    first, second = noisy_second(scene)
    points = scene.model.points
    kappa = denominators(first, scene.depths, scene.camera)
    for basis in (np.eye(12), camera_basis(points[:2], FRAME.to_normalized(scene.exact.second)[:2])):
        found = camera_step(first, scene.depths, second, kappa, basis)
        plain = reference.camera_step(first, scene.depths, second, kappa, basis)
        assert min(np.abs(found - plain).max(), np.abs(found + plain).max()) < 1e-7
        assert (project(found, points)[1] > 0).all()


def test_depth_step_is_that_of_the_twin() -> None:
    """The depths of (B.4) are those of the plain formula, and the least of the weighted error."""
    scene = two_views(40)
    first, second = noisy_second(scene)
    kappa = denominators(first, scene.depths, scene.camera)
    found = depth_step(first, second, scene.camera, kappa)
    np.testing.assert_allclose(found, reference.depth_step(first, second, scene.camera), rtol=1e-9)


def weighted_error(
    first: np.ndarray, depths: np.ndarray, second: np.ndarray, camera: np.ndarray, kappa: np.ndarray
) -> float:
    """Return the sum of (B.2)."""
    points = np.column_stack(
        [depths[:, None] * np.column_stack([first, np.ones(len(first))]), np.ones(len(first))]
    )
    p = points @ camera.T
    return float(((kappa[:, None] * (second * p[:, 2:] - p[:, :2])) ** 2).sum())


def test_steps_do_not_increase_the_weighted_error() -> None:
    """For fixed weights both steps only improve (B.2), with fresh ones it is J; fixed points stay exact."""
    scene = two_views(100)
    first, second = noisy_second(scene)
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
    """The error is that of a general least squares solver to a millionth."""
    scene = two_views(40, kind, motion, noise_px)  # type: ignore[arg-type]
    found = bundle_adjustment(scene.measured, scene.camera, scene.depths, FRAME, np.random.default_rng(0))
    assert found.success
    ours = 40.0 * (found.rms_px / FRAME.scale_px) ** 2
    general = least_error(scene, found, scene.camera, scene.depths)
    assert ours == pytest.approx(general, rel=1e-6)


def test_the_refined_points_obey_the_refined_matrix() -> None:
    """The fundamental matrix is that of the cameras, and the reprojected points satisfy it exactly."""
    scene = two_views(100, noise_px=0.3)
    found = bundle_adjustment(scene.measured, scene.camera, scene.depths, FRAME, np.random.default_rng(0))
    distances = sampson_distances(found.fundamental, scene.measured.first, found.second)
    assert np.abs(distances).max() < 1e-9
    errors = np.linalg.norm(found.second - scene.measured.second, axis=1)
    assert np.sqrt((errors**2).mean()) == pytest.approx(found.rms_px)
    assert found.in_front.all()
    assert np.linalg.norm(found.camera) == pytest.approx(np.sqrt(3.0))


def test_alternation_alone_approaches_the_minimum() -> None:
    """The thesis's alternation descends to about what the joint steps reach."""
    scene = two_views(100, noise_px=0.2)
    camera, depths = start_of(scene)
    errors = {}
    for name, alternations, steps in (("none", 0, 0), ("few", 3, 0), ("many", 100, 0), ("joint", 0, 100)):
        rng = np.random.default_rng(0)
        found = bundle_adjustment(scene.measured, camera, depths, FRAME, rng, alternations, steps)
        errors[name] = found.rms_px
    assert errors["joint"] <= errors["many"] <= errors["few"] <= errors["none"]
    assert errors["many"] < 1.05 * errors["joint"]


@pytest.mark.parametrize(("name", "pairs"), odd_correspondences().items())
def test_odd_inputs_are_values(name: str, pairs: Correspondences) -> None:
    """No input raises or warns, and a failure says why."""
    found = bundle_adjustment(pairs, camera_at(1.0), np.ones(len(pairs)), FRAME, np.random.default_rng(0))
    assert found.success == (not found.reason)
    assert np.isfinite(found.camera).all()
    assert np.isfinite(found.rms_px)
    if name.endswith("points") or name in {"all equal", "nan", "some infinite"}:
        assert not found.success


def test_depths_of_zero_are_refused_as_a_value() -> None:
    """A point at the first camera's centre is no point."""
    scene = two_views(20)
    depths = scene.depths.copy()
    depths[3] = 0.0
    assert not bundle_adjustment(scene.exact, scene.camera, depths, FRAME, np.random.default_rng(0)).success


def test_shapes_must_agree() -> None:
    """One depth belongs to each point."""
    scene = two_views(20)
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="expected"):
        bundle_adjustment(scene.exact, scene.camera, scene.depths[:-1], FRAME, rng)


def test_coordinates_in_the_basis_stay_unit() -> None:
    """The adjusted camera is sqrt(3) W r with r of unit norm."""
    scene = two_views(40, noise_px=0.2)
    found = bundle_adjustment(scene.measured, scene.camera, scene.depths, FRAME, np.random.default_rng(2))
    first = FRAME.to_normalized(scene.measured.first)[found.fixed]
    depths = found.depths[found.fixed]
    points = np.column_stack([depths[:, None] * np.column_stack([first, np.ones(2)]), np.ones(2)])
    basis = camera_basis(points, project(scene.camera, points)[0])
    again = camera_from_coordinates(basis, coordinates_of_camera(basis, found.camera))
    np.testing.assert_allclose(again, found.camera, atol=1e-10)
