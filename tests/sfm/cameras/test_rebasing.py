"""Models of other views of a scene, and the order of depths: that of the rigid motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvc.geometry.cameras import PixelFrame, homogeneous, oriented, project
from sfm.cameras import rebasing
from sfm.cameras.camera_pair import self_calibration
from sfm.cameras.rebasing import is_reversed, rebase, rigid_order
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels, symmetric_distances
from sfm.scene_model import Correspondences, Model
from tests import scenes_3d as small
from tests.sfm.two_views import FRAME, two_views

SMALL = PixelFrame(96, 80)
AFFINE = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
ORBITS_DEG = (4.0, 8.0, -12.0)


def orbit(angle_deg: float, focal: float = 1.2) -> Model:
    """Return the true model of a camera that turns about a point among what it sees."""
    rng = np.random.default_rng(3)
    x, depths = rng.uniform([-0.5, -0.4], [0.5, 0.4], (300, 2)), rng.uniform(6.0, 30.0, 300)
    rotation = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    centre, k = np.array([0.0, 0.0, 8.0]), np.diag([focal, focal, 1.0])
    camera = np.column_stack([k @ rotation @ np.linalg.inv(k), k @ (centre - rotation @ centre)])
    camera *= np.sqrt(3.0 / (camera * camera).sum())
    points = np.column_stack([depths[:, None] * homogeneous(x), np.ones(300)])
    seen = Correspondences(FRAME.to_pixels(x), FRAME.to_pixels(project(camera, points)[0]), np.zeros(300))
    fundamental = fundamental_to_pixels(fundamental_from_camera(camera), FRAME)
    return Model(FRAME, fundamental, camera, seen, depths)


def turned_over(model: Model, constant: float) -> Model:
    """Return the same scene with its inverse depths subtracted from a constant."""
    basis = np.eye(4)
    basis[3, 2:] = constant, -1.0
    camera = oriented(model.second_camera) @ basis
    return replace(model, second_camera=camera, depths=1.0 / (constant - 1.0 / model.depths))


@pytest.mark.parametrize("angle_deg", ORBITS_DEG)
def test_depths_in_the_opposite_order_are_put_right(angle_deg: float) -> None:
    """Nearer is nearer again, whatever the focal length, and both cameras see the points where they did."""
    for truth in (*(orbit(angle_deg, focal) for focal in (0.9, 1.2, 1.6, 2.2)), two_views(300).model):
        wrong = turned_over(truth, 0.5)
        assert is_reversed(wrong)
        ordered = rigid_order(wrong)
        assert ordered is not None
        found = ordered.model
        assert len(found.depths) == len(truth.depths)
        np.testing.assert_array_equal(np.argsort(found.depths), np.argsort(truth.depths))
        xy, depth = project(oriented(found.second_camera), found.points)
        np.testing.assert_allclose(FRAME.to_pixels(xy), truth.correspondences.second, atol=1e-8)
        assert (depth > 0).all()
        assert (found.depths > 0).all()
        converted = ordered.camera(oriented(wrong.second_camera))
        np.testing.assert_array_equal(converted, found.second_camera)
        assert not is_reversed(found)


@pytest.mark.parametrize("angle_deg", ORBITS_DEG)
def test_depths_in_order_are_left_alone(angle_deg: float) -> None:
    for truth in (orbit(angle_deg), two_views(300).model):
        assert rigid_order(truth) is None
        none = replace(truth, correspondences=Correspondences.empty(), depths=np.empty(0))
        assert rigid_order(none) is None


@pytest.mark.parametrize(("num_behind", "believed"), [(54, True), (66, False)])
def test_a_rigid_motion_needs_four_fifths_of_the_points(
    num_behind: int, believed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rebasing, "FOCAL_LENGTHS", (1.2,))
    truth = orbit(8.0)
    behind = truth.points[:num_behind] * [-1.0, -1.0, -1.0, 1.0]
    second = truth.correspondences.second.copy()
    second[:num_behind] = FRAME.to_pixels(project(truth.second_camera, behind)[0])
    seen = replace(truth.correspondences, second=second)
    assert is_reversed(turned_over(replace(truth, correspondences=seen), 0.5)) is believed


@pytest.mark.parametrize("angle_deg", ORBITS_DEG)
def test_self_calibration_of_an_orbit_is_put_in_order(angle_deg: float) -> None:
    """Whichever sign the linear program prefers, the order of the depths is the true one in the end."""
    truth = orbit(angle_deg)
    found = self_calibration(truth.fundamental, truth.correspondences, FRAME)
    kept = found.inliers
    model = replace(
        truth,
        second_camera=found.camera,
        correspondences=truth.correspondences[kept],
        depths=found.depths[kept],
    )
    ordered = rigid_order(model)
    found_depths = ordered.model.depths if ordered else model.depths
    order = np.corrcoef(1.0 / found_depths, 1.0 / truth.depths[kept])[0, 1]
    assert order > 0.9


def test_the_model_of_two_other_views_sees_what_they_see() -> None:
    """Correspondences, depths and epipolar geometry are those of the two views; other cameras convert."""
    model = small.two_planes(noise_px=0.0)
    cameras = [small.camera_at(position) for position in (0.25, 0.75, 0.5)]
    rebased = rebase(model, cameras[0], cameras[1])
    assert rebased is not None
    for camera, seen in zip(cameras, (rebased.model.correspondences.first, None, None), strict=True):
        expected = SMALL.to_pixels(project(camera, model.points)[0])
        converted = rebased.camera(camera)
        assert converted is not None
        found = SMALL.to_pixels(project(converted, rebased.model.points)[0])
        np.testing.assert_allclose(found, expected, atol=1e-9)
        if seen is not None:
            np.testing.assert_allclose(seen, expected, atol=1e-9)
    pairs = rebased.model.correspondences
    assert symmetric_distances(rebased.model.fundamental, pairs.first, pairs.second).max() < 1e-6


def test_inverse_depths_of_a_view_stay() -> None:
    """Depths in a view do not depend on the other view, nor on the sign of its camera."""
    model = small.two_planes(noise_px=0.0)
    first = small.camera_at(0.25)
    near, far = rebase(model, first, small.camera_at(0.5)), rebase(model, first, -small.camera_at(1.0))
    assert near is not None
    assert far is not None
    np.testing.assert_allclose(near.model.depths, far.model.depths)
    np.testing.assert_allclose(near.model.depths, project(first, model.points)[1])


def test_cameras_at_infinity_have_no_model() -> None:
    model = small.two_planes()
    away = np.diag([1.0, -1.0, -1.0]) @ small.camera_at(0.5)
    assert rebase(model, AFFINE, small.camera_at(1.0)) is None
    assert rebase(model, small.camera_at(0.0), AFFINE) is None
    assert rebase(model, small.camera_at(0.0), away) is None
    # A camera that is nearly affine makes others have no finite centre in its basis.
    nearly = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1e-4, 12.0]])
    assert rebase(model, nearly, small.camera_at(1.0)) is None
    rebased = rebase(model, small.camera_at(0.0), small.camera_at(1.0))
    assert rebased is not None
    assert rebased.camera(AFFINE) is None
