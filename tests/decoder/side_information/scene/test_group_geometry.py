"""Geometry of a group of pictures in another basis."""

from dataclasses import replace

import numpy as np

from decoder.side_information.scene.group_geometry import GroupGeometry, in_rigid_order
from dvc.geometry.cameras import oriented, project
from dvc.tracks import PointTracks
from sfm.scene_model import Model
from tests.scenes_3d import camera_at, two_planes

INSTANTS = (0.0, 0.4, 1.0)


def group(model: Model, basis: np.ndarray) -> GroupGeometry:
    """Return a group whose second frame, but not its third, has a camera, all in some basis."""
    first, middle, last = (oriented(camera_at(position)) @ basis for position in INSTANTS)
    cameras = (first, middle, None, last)
    return GroupGeometry(8, PointTracks.none(4), model, cameras, "", ("", "", "lost", ""), True)


def test_all_cameras_of_a_group_come_along() -> None:
    """Cameras see the points where they did, nearer is nearer again, and what is missing stays missing."""
    truth = two_planes(176, 144, noise_px=0.0)
    basis = np.eye(4)
    basis[3, 2:] = 2.0 / truth.depths.min(), -1.0
    depths = 1.0 / (basis[3, 2] - 1.0 / truth.depths)
    wrong = replace(truth, second_camera=oriented(truth.second_camera) @ basis, depths=depths)
    found = in_rigid_order(group(wrong, basis))
    assert found.model is not None
    order = np.corrcoef(1.0 / found.model.depths, 1.0 / truth.depths)[0, 1]
    assert order > 0.999
    for position, camera in zip(
        INSTANTS, (found.cameras[0], found.cameras[1], found.cameras[3]), strict=True
    ):
        assert camera is not None
        expected, _ = project(camera_at(position), truth.points)
        xy, depth = project(oriented(camera), found.model.points)
        np.testing.assert_allclose(xy, expected, atol=1e-9)
        assert (depth > 0).all()
    assert found.cameras[2] is None
    assert found.camera_reasons == ("", "", "lost", "")


def test_a_group_in_order_stays_as_it_is() -> None:
    """Nothing is copied where nothing has to change."""
    right = group(two_planes(176, 144), np.eye(4))
    assert in_rigid_order(right) is right
