"""The order of depths: that of the rigid motion, whichever frame the model came in."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvc.geometry.cameras import homogeneous, oriented, project
from sfm.cameras import rebasing
from sfm.cameras.rebasing import is_reversed, rigid_order
from sfm.cameras.self_calibration import self_calibration
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels
from sfm.scene_model import Correspondences, Model
from tests.sfm.two_views import FRAME, two_views

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
    """The true model needs no other basis, nor does one without points."""
    for truth in (orbit(angle_deg), two_views(300).model):
        assert rigid_order(truth) is None
        none = replace(truth, correspondences=Correspondences.empty(), depths=np.empty(0))
        assert rigid_order(none) is None


@pytest.mark.parametrize(("num_behind", "believed"), [(54, True), (66, False)])
def test_a_rigid_motion_needs_four_fifths_of_the_points(
    num_behind: int, believed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where less of them lie before both cameras the model stays as it is."""
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
    assert found.success
    kept = found.kept
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
