"""Views of general cameras: labels a pixel of parallax apart, and what is refused."""

from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from dvc.array_files import MAX_LABELS
from dvc.dibr import view_set
from dvc.dibr.view_encoder import check_memory
from dvc.dibr.view_set import Views, depths_of_points, labels_of_depths, views_of_cameras, with_near_origin
from dvc.dibr.view_stream import Header, decode_header, encode_header
from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import CalibratedViews, Camera
from dvc.geometry.viewpoints import CalibratedViewpoint, warp_between
from dvc.geometry.warping import warp_grid

SIZE = 64, 48
INTRINSIC = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 23.5], [0.0, 0.0, 1.0]])


def camera(name: str, turn: list[float], translation: list[float], **options: object) -> Camera:
    rotation = np.asarray(cv2.Rodrigues(np.array(turn, np.float64))[0])
    return Camera(name, INTRINSIC, rotation, np.array(translation, np.float64), SIZE, **options)  # type: ignore[arg-type]


STILL = camera("a", [0, 0, 0], [0, 0, 0])


def viewpoint_of(one: Camera) -> CalibratedViewpoint:
    return CalibratedViewpoint(one.K, np.column_stack([one.R, one.t]))


def views_of(*cameras: Camera) -> Views:
    pictures = [np.full((SIZE[1], SIZE[0], 3), 9, np.uint8) for _ in cameras]
    return views_of_cameras(pictures, cameras)


@pytest.mark.parametrize("translation", [[-1.0, 0.2, 0.0], [-0.6, 0.1, -0.8], [0.3, 0.0, 0.9]])
def test_a_step_is_at_most_a_pixel_of_parallax(translation: list[float]) -> None:
    far = camera("far", [0.02, -0.1, 0.05], translation)
    views = views_of(STILL, camera("b", [0.0, 0.0, 0.0], [0.1 * x for x in translation]), far)
    labels = labels_of_depths(views, 3.0, np.inf)
    warp = warp_between(views.viewpoints[0], views.viewpoints[2])
    inverse = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
    places = [warp_grid(warp, np.full((SIZE[1], SIZE[0]), one))[..., :2] for one in inverse]
    steps = [np.hypot(*(b - a).transpose(2, 0, 1)).max() for a, b in pairwise(places)]
    assert 0.7 < max(steps) <= 1.0 + 1e-6
    assert inverse[0] == 0.0
    assert inverse[-1] == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize("away", [500.0, 5e6])
def test_an_origin_far_away_is_moved_to_the_first_camera(away: float) -> None:
    origin = np.array([away, -away, 0.1 * away])
    turns, centres = ([0.1, 0.2, 0.0], [0.0, -0.1, 0.3]), np.array([[0.0, 0.0, 0.0], [1.0, 0.25, 0.0]])
    near = [camera(f"{k}", turn, [0, 0, 0]) for k, turn in enumerate(turns)]
    near = [replace(one, t=-one.R @ place) for one, place in zip(near, centres, strict=True)]
    points = np.array([[0, 0, 4.0], [0, 0, 9.0]])
    given = CalibratedViews(tuple(replace(one, t=one.t - one.R @ origin) for one in near), origin + points)
    found = with_near_origin(given)
    if away < 1000.0:
        assert found is given
        return
    np.testing.assert_allclose([one.centre for one in found.cameras], centres, atol=1e-6)
    np.testing.assert_allclose(found.points, points, atol=1e-6)
    views = views_of(*found.cameras)
    labels = labels_of_depths(views, *depths_of_points(views, found.points))
    exact = Header(views.shape, "l", labels, (0,), 1, views.viewpoints)
    header, _ = decode_header(encode_header(exact))
    warps = [warp_between(*one) for one in (header.viewpoints, [viewpoint_of(one) for one in near])]
    np.testing.assert_allclose(*warps, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("parallax_px", "refused"), [(MAX_LABELS - 1.0, False), (MAX_LABELS - 0.9, True)])
def test_parallax_of_as_many_labels_as_there_may_be(
    parallax_px: float, refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view_set, "_largest_parallax", lambda *_: parallax_px)
    views = views_of(STILL, camera("b", [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]))
    with pytest.raises(ConfigError, match="labels a pixel apart") if refused else nullcontext():
        assert labels_of_depths(views, 3.0, np.inf).num_labels == MAX_LABELS


def test_labels_may_be_counted_and_are_limited() -> None:
    views = views_of(STILL, camera("b", [0, 0, 0], [-1.0, 0, 0]))
    assert labels_of_depths(views, 1e-3, 10.0, 17).num_labels == 17
    with pytest.raises(ConfigError, match="more than 4096 labels"):
        labels_of_depths(views, 1e-3, 10.0)


def test_cameras_that_see_no_depth_are_refused() -> None:
    with pytest.raises(ConfigError, match="same position"):
        views_of(STILL, camera("b", [0, 0.1, 0], [0, 0, 0]))
    with pytest.raises(ConfigError, match="camera of b: lens distortion"):
        views_of(STILL, camera("b", [0, 0, 0], [-1, 0, 0], distortion=(0.1, 0.0, 0.0, 0.0)))
    views = views_of(STILL, camera("b", [0, 0, 0], [-1.0, 0, 0]))
    for points in (np.zeros((0, 3)), [[0, 0, 5.0], [1, 0, 5.0]], [[0, 0, -5.0], [1, 0, -6]]):
        with pytest.raises(ConfigError, match="no points"):
            depths_of_points(views, np.array(points))
    near, far = depths_of_points(views, np.array([[0, 0, 2.0], [0, 0, 4.0]]))
    assert 1.9 < near < 2.0
    assert 4.0 < far < 4.4


def test_memory_is_told_before_it_is_taken() -> None:
    check_memory((1000, 1500), 60)
    with pytest.raises(ConfigError, match="4096 disparities of 450x375 pixels"):
        check_memory((375, 450), 4096)
