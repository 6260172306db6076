"""Models of other views of the same scene."""

import numpy as np

from dvc.geometry.cameras import PixelFrame, project
from sfm.cameras.rebasing import rebase
from sfm.estimation.epipolar import symmetric_distances
from tests.scenes_3d import camera_at, two_planes

FRAME = PixelFrame(96, 80)


def test_the_model_of_two_other_views_sees_what_they_see() -> None:
    """Correspondences, depths and epipolar geometry are those of the two views; other cameras convert."""
    model = two_planes(noise_px=0.0)
    cameras = [camera_at(position) for position in (0.25, 0.75, 0.5)]
    rebased = rebase(model, cameras[0], cameras[1])
    assert rebased is not None
    for camera, seen in zip(cameras, (rebased.model.correspondences.first, None, None), strict=True):
        expected = FRAME.to_pixels(project(camera, model.points)[0])
        converted = rebased.camera(camera)
        assert converted is not None
        found = FRAME.to_pixels(project(converted, rebased.model.points)[0])
        np.testing.assert_allclose(found, expected, atol=1e-9)
        if seen is not None:
            np.testing.assert_allclose(seen, expected, atol=1e-9)
    pairs = rebased.model.correspondences
    assert symmetric_distances(rebased.model.fundamental, pairs.first, pairs.second).max() < 1e-6


def test_inverse_depths_of_a_view_stay() -> None:
    """Depths in a view do not depend on the other view, nor on the sign of its camera."""
    model = two_planes(noise_px=0.0)
    first = camera_at(0.25)
    near, far = rebase(model, first, camera_at(0.5)), rebase(model, first, -camera_at(1.0))
    assert near is not None
    assert far is not None
    np.testing.assert_allclose(near.model.depths, far.model.depths)
    np.testing.assert_allclose(near.model.depths, project(first, model.points)[1])


def test_cameras_at_infinity_have_no_model() -> None:
    """A camera without a finite centre, or one that looks away, gives none."""
    model = two_planes()
    affine = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    away = np.diag([1.0, -1.0, -1.0]) @ camera_at(0.5)
    assert rebase(model, affine, camera_at(1.0)) is None
    assert rebase(model, camera_at(0.0), affine) is None
    assert rebase(model, camera_at(0.0), away) is None


def test_cameras_that_come_to_lie_at_infinity_have_no_model() -> None:
    """A camera that is nearly affine makes others have no finite centre in its basis."""
    model = two_planes()
    nearly = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1e-4, 12.0]])
    assert rebase(model, nearly, camera_at(1.0)) is None
    rebased = rebase(model, camera_at(0.0), camera_at(1.0))
    assert rebased is not None
    affine = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    assert rebased.camera(affine) is None
