"""Prediction from a model of the scene, with tracked points and without."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.methods import (
    INTERPOLATORS,
    METHODS,
    GroupGeometry,
    SceneInterpolation,
    TrackedSceneInterpolation,
    in_rigid_order,
)
from decoder.side_information.protocol import ReferenceFrame, SceneInterpolatorType
from decoder.side_information.scene_interpolators import BlockInterpolator, DepthInterpolator
from dvc.config import CodecConfig, GeometryConfig, TracksConfig, VideoConfig, codec_config
from dvc.geometry.cameras import PixelFrame, oriented, project
from dvc.metrics import psnr_db
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from encoder.corner_detector import CornerDetector
from sfm.scene_model import Model
from tests.scenes_3d import camera_at, render, two_planes

PIXELS = PixelFrame(176, 144)
CONFIG = codec_config(
    VideoConfig(176, 144, 25, 1), side_information={"track_corrections": False, "fallback": "block-motion"}
)
BY_TRACKS = replace(CONFIG, side_information=replace(CONFIG.side_information, fallback="tracks"))
INSTANTS = (0.0, 0.45, 0.55, 0.6, 1.0)
"""The camera does not move evenly."""
CHROMA = np.full((72, 88), 100, np.uint8), np.full((72, 88), 150, np.uint8)
FRAMES = [Frame(render(position, PIXELS)[0], CHROMA) for position in INSTANTS]
REFERENCES = [ReferenceFrame(8 + k, frame) for k, frame in enumerate(FRAMES)]
KEYS = [REFERENCES[0], REFERENCES[4]]


def true_tracks(number: int = 90) -> PointTracks:
    points = two_planes(176, 144).points[:number]
    seen = [PIXELS.to_pixels(project(camera_at(position), points)[0]) for position in INSTANTS]
    return PointTracks(np.round(np.stack(seen, axis=1)))


def quality(
    method: TrackedSceneInterpolation | SceneInterpolation,
    points: PointTracks | FeaturePoints | None,
    instant: int,
) -> float:
    """Return the PSNR of a prediction from the key frames."""
    [prediction] = method.predict(KEYS, points, [instant])
    return psnr_db(to_uint8(prediction.luma), FRAMES[instant - 8].luma)


@pytest.mark.parametrize("interpolator", [DepthInterpolator, BlockInterpolator])
def test_tracks_tell_where_the_camera_is(interpolator: SceneInterpolatorType) -> None:
    tracked, blind = TrackedSceneInterpolation(interpolator, CONFIG), SceneInterpolation(interpolator, CONFIG)
    for instant in (9, 11):
        assert quality(tracked, true_tracks(), instant) > quality(blind, None, instant) + 4.0


def test_frames_that_are_decoded_serve_as_references() -> None:
    method = TrackedSceneInterpolation(DepthInterpolator, CONFIG)
    far = quality(method, true_tracks(), 9)
    [near] = method.predict([REFERENCES[0], REFERENCES[2], REFERENCES[4]], true_tracks(), [9])
    assert near.success
    assert psnr_db(to_uint8(near.luma), FRAMES[1].luma) > far + 0.5


def test_the_prediction_does_not_depend_on_what_was_asked_before() -> None:
    method, tracks = TrackedSceneInterpolation(DepthInterpolator, CONFIG), true_tracks()
    [alone] = TrackedSceneInterpolation(DepthInterpolator, CONFIG).predict(KEYS, tracks, [9])
    method.predict([REFERENCES[0], REFERENCES[2], REFERENCES[4]], tracks, [9])
    method.predict([REFERENCES[0], REFERENCES[1]], PointTracks.none(2), [])
    for _ in range(2):
        [again] = method.predict(KEYS, tracks, [9])
        np.testing.assert_array_equal(again.luma, alone.luma)


def test_without_tracks_the_camera_is_guessed() -> None:
    [expected] = SceneInterpolation(DepthInterpolator, CONFIG).predict(KEYS, None, [10])
    for points in (None, PointTracks.none(5)):
        [found] = TrackedSceneInterpolation(DepthInterpolator, CONFIG).predict(KEYS, points, [10])
        np.testing.assert_array_equal(found.luma, expected.luma)


def test_block_motion_serves_where_there_is_no_scene() -> None:
    black = ReferenceFrame(12, Frame(np.zeros((144, 176), np.uint8), CHROMA))
    [found] = TrackedSceneInterpolation(DepthInterpolator, CONFIG).predict(
        [KEYS[0], black], true_tracks(), [10]
    )
    assert not found.success
    assert found.reason
    assert found.method == "mci"


def test_references_warped_by_tracks_serve_where_there_is_no_scene() -> None:
    black = ReferenceFrame(12, Frame(np.zeros((144, 176), np.uint8), CHROMA))
    method = TrackedSceneInterpolation(DepthInterpolator, BY_TRACKS)
    [found] = method.predict([KEYS[0], black], true_tracks(), [10])
    assert (found.success, found.method) == (False, "tracks")
    assert found.reason
    assert found.expected_error is not None
    assert found.chroma is not None
    np.testing.assert_array_equal(found.chroma[0], 100)
    assert found.refiner is not None
    wanted = FRAMES[2].luma
    refined = found.refiner.refine(wanted)
    assert psnr_db(to_uint8(refined.luma), wanted) > psnr_db(to_uint8(found.luma), wanted)


def test_references_warped_by_tracks_join_the_scene() -> None:
    """Blended with them, the scene is on average as good as beside aligned block motion."""
    old, new = (TrackedSceneInterpolation(DepthInterpolator, config) for config in (CONFIG, BY_TRACKS))
    gained_db = [quality(new, true_tracks(), k) - quality(old, true_tracks(), k) for k in (9, 10, 11)]
    assert np.mean(gained_db) > -0.2
    assert max(np.abs(gained_db)) > 0.0


HOSTILE: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nan": lambda positions: np.full_like(positions, np.nan),
    "lost": lambda positions: np.where(np.arange(5)[:, None] < 2, positions, np.nan),
    "one place": lambda positions: np.full_like(positions, 50.0),
    "noise": lambda positions: np.random.default_rng(0).uniform(0, 140, positions.shape),
    "outside": lambda positions: positions + np.array([0.0, 1e6, 1e6, 1e6, 0.0])[:, None],
    "too few": lambda positions: positions[:3],
}


@pytest.mark.parametrize("config", [CONFIG, BY_TRACKS], ids=["block motion", "tracks"])
@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_tracks_give_a_prediction(kind: str, config: CodecConfig) -> None:
    method = TrackedSceneInterpolation(DepthInterpolator, config)
    tracks = PointTracks(HOSTILE[kind](true_tracks().positions))
    for prediction in method.predict(KEYS, tracks, [9, 10, 11]):
        assert np.isfinite(prediction.luma).all()
        assert np.isfinite(np.stack(prediction.compensated)).all()
        assert prediction.success == (not prediction.reason)
        if kind in ("nan", "too few", "one place", "noise"):
            assert not prediction.success


def test_corners_of_each_frame_will_do() -> None:
    corners = CornerDetector(176).detect([frame.luma for frame in FRAMES[1:4]])
    config = codec_config(CONFIG.video, "3d-td", side_information=CONFIG.side_information)
    tracked, blind = (
        TrackedSceneInterpolation(DepthInterpolator, config),
        SceneInterpolation(DepthInterpolator, config),
    )
    [prediction] = tracked.predict(KEYS, corners, [11])
    assert prediction.success
    assert quality(tracked, corners, 11) > quality(blind, None, 11) + 4.0


def test_without_corners_the_scene_is_that_of_no_tracks() -> None:
    config = codec_config(CONFIG.video, "3d-td", side_information=CONFIG.side_information)
    none = FeaturePoints((np.empty((0, 2)),) * 3)
    [found] = TrackedSceneInterpolation(DepthInterpolator, config).predict(KEYS, none, [10])
    [expected] = SceneInterpolation(DepthInterpolator, config).predict(KEYS, None, [10])
    np.testing.assert_array_equal(found.luma, expected.luma)


def test_the_codec_says_which_method_it_is() -> None:
    assert isinstance(METHODS["depth"](CONFIG), TrackedSceneInterpolation)
    assert isinstance(METHODS["blocks"](UNTRACKED), SceneInterpolation)
    assert isinstance(METHODS["fused"](codec_config(CONFIG.video, "2d")), BlockMotionInterpolation)


def test_tracks_correct_what_is_rendered_if_the_stream_says_so() -> None:
    settings = replace(CONFIG.side_information, track_corrections=True)
    method = TrackedSceneInterpolation(DepthInterpolator, replace(CONFIG, side_information=settings))
    plain = TrackedSceneInterpolation(DepthInterpolator, CONFIG)
    for instant in (9, 11):
        gain_db = quality(method, true_tracks(), instant) - quality(plain, true_tracks(), instant)
        assert gain_db != 0.0
        assert gain_db > -0.1


UNTRACKED = codec_config(CONFIG.video, "3d")


EVEN = [Frame(render(position, PIXELS)[0], CHROMA) for position in (0.0, 0.25, 0.5, 0.75, 1.0)]
EVEN_KEYS = [ReferenceFrame(8, EVEN[0]), ReferenceFrame(12, EVEN[4])]


@pytest.mark.parametrize("name", INTERPOLATORS)
@pytest.mark.parametrize("backend", ["native", "colmap"])
def test_the_scene_serves(name: str, backend: str) -> None:
    config = codec_config(UNTRACKED.video, "3d", geometry=GeometryConfig(backend))
    predictions = SceneInterpolation(INTERPOLATORS[name], config).predict(EVEN_KEYS, None, [9, 10, 11])
    others = BlockMotionInterpolation().predict(EVEN_KEYS, None, [9, 10, 11])
    for prediction, other, frame in zip(predictions, others, EVEN[1:4], strict=True):
        assert (prediction.method, prediction.success, prediction.reason) == (name, True, "")
        assert prediction.chroma is not None
        assert abs(int(prediction.chroma[0][36, 44]) - 100) <= 1
        assert psnr_db(to_uint8(prediction.luma), frame.luma) > psnr_db(to_uint8(other.luma), frame.luma)


@pytest.mark.parametrize("name", INTERPOLATORS)
def test_untracked_block_motion_serves_where_there_is_no_scene(name: str) -> None:
    cut = [EVEN_KEYS[0], ReferenceFrame(12, Frame(np.zeros((144, 176), np.uint8), CHROMA))]
    [prediction] = SceneInterpolation(INTERPOLATORS[name], UNTRACKED).predict(cut, None, [10])
    [block_motion] = BlockMotionInterpolation().predict(cut, None, [10])
    assert prediction.method == "mci"
    assert not prediction.success
    assert prediction.reason
    np.testing.assert_array_equal(prediction.luma, block_motion.luma)


def test_order_and_company_do_not_matter() -> None:
    method = SceneInterpolation(DepthInterpolator, UNTRACKED)
    [alone] = SceneInterpolation(DepthInterpolator, UNTRACKED).predict(EVEN_KEYS, None, [10])
    method.predict([EVEN_KEYS[0], ReferenceFrame(10, EVEN[2])], None, [9])
    for _ in range(2):
        [again] = method.predict(EVEN_KEYS, None, [10])
        np.testing.assert_array_equal(again.luma, alone.luma)
        np.testing.assert_array_equal(again.compensated[1], alone.compensated[1])


def test_all_hypotheses_are_left_to_the_decoder() -> None:
    """With tracks or without, block motion, depth and blocks are alternatives of what they are fused to."""
    points = two_planes(176, 144).points[:90]
    instants = (0.0, 0.3, 0.5, 0.7, 1.0)
    seen = [PIXELS.to_pixels(project(camera_at(position), points)[0]) for position in instants]
    tracks = PointTracks(np.round(np.stack(seen, axis=1)).astype(np.float64))
    for codec, kind, received in (("3d-te", "encoder", tracks), ("3d", "none", None)):
        config = codec_config(CONFIG.video, codec, tracks=TracksConfig(kind))
        [found] = METHODS["fused"](config).predict(KEYS, received, [10])
        assert (found.success, found.method) == (True, "fused")
        assert len(found.alternatives) == 3


GEOMETRY_INSTANTS = (0.0, 0.4, 1.0)


def group(model: Model, basis: np.ndarray) -> GroupGeometry:
    """Return a group whose second frame, but not its third, has a camera, all in some basis."""
    first, middle, last = (oriented(camera_at(position)) @ basis for position in GEOMETRY_INSTANTS)
    cameras = (first, middle, None, last)
    return GroupGeometry(8, PointTracks.none(4), model, cameras, "", ("", "", "lost", ""), True)


def test_all_cameras_of_a_group_come_along() -> None:
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
        GEOMETRY_INSTANTS, (found.cameras[0], found.cameras[1], found.cameras[3]), strict=True
    ):
        assert camera is not None
        expected, _ = project(camera_at(position), truth.points)
        xy, depth = project(oriented(camera), found.model.points)
        np.testing.assert_allclose(xy, expected, atol=1e-9)
        assert (depth > 0).all()
    assert found.cameras[2] is None
    assert found.camera_reasons == ("", "", "lost", "")


def test_a_group_in_order_stays_as_it_is() -> None:
    right = group(two_planes(176, 144), np.eye(4))
    assert in_rigid_order(right) is right
