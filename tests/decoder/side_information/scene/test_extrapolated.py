"""Frames after those that show the scene."""

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.side_information.extrapolation import TrackedExtrapolation
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.side_information.scene.depth import DepthInterpolator
from decoder.side_information.scene.extrapolated import Scene, extrapolate
from decoder.side_information.scene.tracked import TrackedSceneInterpolation
from dvc.config import VideoConfig, codec_config
from dvc.metrics import psnr_db
from dvc.multiview.cameras import PixelFrame, project
from dvc.tracks import PointTracks
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import camera_at, render, two_planes

PIXELS = PixelFrame(176, 144)
CONFIG = codec_config(VideoConfig(176, 144, 25, 1))
INSTANTS = (0.0, 0.25, 0.5, 0.8)
FRAMES = [ReferenceFrame(k, Frame(render(position, PIXELS)[0])) for k, position in enumerate(INSTANTS)]


def tracks(*instants: int, number: int = 90) -> PointTracks:
    """Return points at some instants, to whole pixels."""
    points = two_planes(176, 144).points[:number]
    seen = [PIXELS.to_pixels(project(camera_at(INSTANTS[k]), points)[0]) for k in instants]
    return PointTracks(np.round(np.stack(seen, axis=1)))


def scene() -> Scene:
    """Return what the first and the third frame show."""
    found = TrackedSceneInterpolation(DepthInterpolator, CONFIG).scene(FRAMES[0], FRAMES[2], tracks(0, 1, 2))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def known() -> Scene:
    """Return what the first and the third frame show."""
    return scene()


def predicted(known: Scene | None, points: PointTracks) -> Prediction:
    """Predict the last frame from the third."""
    return TrackedExtrapolation().predict([FRAMES[2]], points, 2, 3, known)


def quality(luma: NDArray[np.float64]) -> float:
    """Return the PSNR inside of what the third frame shows."""
    inside = np.s_[12:-12, 12:-30]
    return psnr_db(to_uint8(luma)[inside], FRAMES[3].frame.luma[inside])


def test_parallax_is_predicted_where_tracks_alone_miss_it(known: Scene) -> None:
    """Two planes move apart: the scene draws what the smooth fields of tracks blur."""
    alone, found = (predicted(one, tracks(2, 3)) for one in (None, known))
    assert found.success
    assert quality(found.luma) > quality(alone.luma) + 2.0
    assert len(found.alternatives) == 1  # what tracks alone predict
    np.testing.assert_array_equal(found.alternatives[0], alone.luma)


def test_points_go_on_where_tracks_have_ended(known: Scene) -> None:
    """Points that a new group finds again have depth from tracks too; others that which is drawn."""
    points = tracks(2, 3)
    rendered, reason = extrapolate(known, points.positions[:, 0], points.positions[:, 1])
    assert rendered is not None
    assert not reason
    strangers = points.positions + np.array([1.5, 0.0])
    other, _ = extrapolate(known, strangers[:, 0], strangers[:, 1])
    assert other is not None
    assert quality(rendered.luma) > quality(other.luma) - 0.5
    assert quality(other.luma) > 25.0


@pytest.mark.parametrize("number", [0, 3])
def test_too_few_points_leave_it_to_tracks(known: Scene, number: int) -> None:
    """No camera, and why."""
    found = predicted(known, tracks(2, 3, number=number))
    assert not found.success
    assert "points" in found.reason
    np.testing.assert_array_equal(found.luma, predicted(None, tracks(2, 3, number=number)).luma)


def test_points_that_contradict_each_other_leave_it_to_tracks(known: Scene) -> None:
    """Points that jump about are seen by no camera."""
    points = tracks(2, 3).positions.copy()
    points[:, 1] = np.random.default_rng(5).uniform(0.0, 140.0, points[:, 1].shape)
    assert not predicted(known, PointTracks(np.round(points))).success
