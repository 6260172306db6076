"""Depth of tracked points from all views that see them."""

import numpy as np
import pytest

from dvc.geometry.cameras import PixelFrame, project
from dvc.geometry.triangulation import track_depths
from tests.scenes_3d import camera_at, two_planes

FRAME = PixelFrame(96, 80)
INSTANTS = (0.0, 0.2, 0.5, 0.8, 1.0)


def tracks() -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Return exact tracks, their cameras, and the points."""
    points = two_planes(noise_px=0.0).points[:60]
    cameras = [camera_at(position) for position in INSTANTS]
    positions = np.stack([FRAME.to_pixels(project(camera, points)[0]) for camera in cameras], axis=1)
    return positions, cameras, points


@pytest.mark.parametrize("view", [0, 2, 4])
def test_exact_tracks_have_exact_depths(view: int) -> None:
    positions, cameras, points = tracks()
    found = track_depths(positions, cameras, view, FRAME)
    np.testing.assert_allclose(found.inverse_depth, 1.0 / project(cameras[view], points)[1], rtol=1e-6)
    assert found.rms_px.max() < 1e-6


def test_short_tracks_have_less_certain_depths() -> None:
    positions, cameras, points = tracks()
    whole = track_depths(positions, cameras, 0, FRAME)
    positions[:, 2:] = np.nan
    short = track_depths(positions, cameras, 0, FRAME)
    np.testing.assert_allclose(short.inverse_depth, 1.0 / project(cameras[0], points)[1], rtol=1e-6)
    assert (short.sigma_px > 2.0 * whole.sigma_px).all()


def test_views_that_do_not_see_a_point_do_not_make_it_uncertain() -> None:
    positions, cameras, points = tracks()
    alone = track_depths(positions, cameras, 0, FRAME)
    turned = np.diag([-1.0, 1.0, -1.0]) @ camera_at(0.5)
    aside = camera_at(0.5) + np.outer([5.0, 0.0, 0.0], camera_at(0.5)[2])
    depths = project(turned, points)[1]
    assert (depths < 0).all()
    unseen = np.full((len(points), 2, 2), np.nan)
    found = track_depths(np.concatenate([positions, unseen], axis=1), [*cameras, turned, aside], 0, FRAME)
    np.testing.assert_array_equal(found.sigma_px, alone.sigma_px)


def test_wrong_tracks_are_reported_by_their_distance() -> None:
    positions, cameras, _ = tracks()
    positions[3, 2] += [0.0, 9.0]
    found = track_depths(positions, cameras, 0, FRAME)
    assert found.rms_px[3] > 2.0
    assert np.delete(found.rms_px, 3).max() < 1e-6


def test_what_is_not_known_has_no_depth() -> None:
    positions, cameras, _ = tracks()
    positions[0, 0] = np.nan
    positions[1, 1:] = np.nan
    found = track_depths(positions, [cameras[0], None, None, None, cameras[4]], 0, FRAME)
    assert np.isnan(found.inverse_depth[:2]).all()
    assert np.isinf(found.rms_px[:2]).all()
    assert np.isfinite(found.inverse_depth[2:]).all()
    alone = track_depths(positions, [cameras[0], None, None, None, None], 0, FRAME)
    assert np.isnan(alone.inverse_depth).all()
    with pytest.raises(ValueError, match="no camera"):
        track_depths(positions, [None, *cameras[1:]], 0, FRAME)
