"""Correspondences, normalised coordinates, projection and triangulation."""

import numpy as np

from dvc.geometry.cameras import PixelFrame, project
from dvc.geometry.triangulation import triangulate_depth
from sfm.scene_model import Correspondences
from tests.sfm.two_views import euclidean_scene


def test_normalised_coordinates() -> None:
    """The centre of the image is the origin, its longer side one unit; matrices and methods agree."""
    frame = PixelFrame(353, 289)
    points = np.array([[176.0, 144.0], [352.0, 0.0]])
    normalized = frame.to_normalized(points)
    np.testing.assert_allclose(normalized[0], [0.0, 0.0])
    np.testing.assert_allclose(normalized[1], [176 / 353, -144 / 353])
    np.testing.assert_allclose(frame.to_pixels(normalized), points)
    np.testing.assert_allclose(
        frame.normalized_from_pixel @ frame.pixel_from_normalized, np.eye(3), atol=1e-15
    )
    np.testing.assert_allclose(frame.normalized_from_pixel @ [352.0, 0.0, 1.0], [*normalized[1], 1.0])


def test_choosing_and_joining() -> None:
    """Correspondences are chosen by mask or index, joined in order, and know their motion."""
    points = np.arange(8.0).reshape(4, 2)
    matches = Correspondences(points, points + np.array([1.0, -2.0]), np.arange(4.0))
    assert len(matches) == 4
    np.testing.assert_array_equal(matches.motion, np.tile([1.0, -2.0], (4, 1)))
    joined = Correspondences.concatenate([matches[matches.error > 1.5], matches[np.array([0])]])
    np.testing.assert_array_equal(joined.error, [2.0, 3.0, 0.0])
    np.testing.assert_array_equal(joined.first[2], points[0])
    assert len(Correspondences.empty()) == 0


def test_points_of_a_model_project_to_its_correspondences() -> None:
    """(5.3): points project into both key frames where they were seen; triangulation finds depths."""
    model = euclidean_scene(plane=(0.1, -0.05, 0.08)).model
    frame, matches = model.pixel_frame, model.correspondences
    first, depth = project(model.first_camera, model.points)
    np.testing.assert_allclose(frame.to_pixels(first), matches.first, atol=1e-9)
    np.testing.assert_allclose(depth, model.depths)
    second, depth_second = project(model.second_camera, model.points)
    np.testing.assert_allclose(frame.to_pixels(second), matches.second, atol=1e-9)
    found = triangulate_depth(
        frame.to_normalized(matches.first), model.second_camera, frame.to_normalized(matches.second)
    )
    np.testing.assert_allclose(found[0], model.depths, rtol=1e-9)
    np.testing.assert_allclose(found[1], depth_second, rtol=1e-9)
