"""What every side-information method must do, whatever it is given."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from decoder.side_information.protocol import Prediction, ReferenceFrame, SideInformationMethod
from dvc.config import CodecConfig, TracksConfig, VideoConfig, codec_config
from dvc.contracts.frames import moving_texture
from dvc.metrics import psnr_db
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame, chroma_shape
from dvc.video.frames import Plane
from dvc.wynerziv.transform import to_uint8
from encoder.corners import CornerDetector
from encoder.point_tracker import PointTracker

SHAPES = [(1, 1), (1, 17), (3, 5), (4, 4), (16, 16), (17, 23), (40, 56)]
CODECS = {"3d": "none", "3d-te": "encoder", "3d-td": "decoder"}
"""Codecs by the kind of points that they send."""
Points = PointTracks | FeaturePoints | None
Make = Callable[[CodecConfig], SideInformationMethod]


class Build(NamedTuple):
    """Builds a method with default settings, and points as its codec sends them."""

    method: Callable[[], SideInformationMethod]
    kind: str

    def points(self, frames: list[Frame], num_points: int = 40) -> Points:
        """Return points of all frames: tracked at the encoder, corners of each frame, or none."""
        if self.kind == "none":
            return None
        lumas = [frame.luma for frame in frames]
        if self.kind == "decoder":
            return CornerDetector(num_points).detect(lumas[1:-1])
        tracker = PointTracker(num_points, 1)
        tracker.start(lumas[0])
        for luma in lumas[1:]:
            tracker.step(luma)
        return tracker.tracks(len(lumas))


def references_of(frames: list[Frame]) -> list[ReferenceFrame]:
    """Return the first and the last frame as key frames."""
    return [ReferenceFrame(10, frames[0]), ReferenceFrame(10 + len(frames) - 1, frames[-1])]


def check(prediction: Prediction, like: Frame) -> None:
    """Check types, shapes and ranges of a prediction against a frame of the sequence."""
    planes = [prediction.luma, *prediction.compensated]
    if prediction.expected_error is not None:
        planes.append(prediction.expected_error)
    for plane in planes:
        assert plane.dtype == np.float64
        assert plane.shape == like.luma.shape
        assert np.isfinite(plane).all()
    assert len(prediction.compensated) >= 1
    assert prediction.luma.min() >= 0
    assert prediction.luma.max() <= 255
    assert prediction.success == (prediction.reason == "")
    assert prediction.method


def check_chroma(chroma: tuple[Plane, Plane] | None, like: Frame) -> None:
    """Check that chroma is there where frames have it, and fits them."""
    assert (chroma is None) == (like.chroma is None)
    for plane in chroma or ():
        assert plane.dtype == np.uint8
        assert plane.shape == chroma_shape(*like.luma.shape)


class SideInformationContract:
    """Tests of a method; a class derived from this one says what makes it, by the fixture `make`."""

    @pytest.fixture(params=CODECS)
    def build(self, request: pytest.FixtureRequest, make: Make) -> Build:
        """Return what builds the method for a codec."""
        kind = CODECS[request.param]
        config = codec_config(VideoConfig(56, 40, 25, 1), request.param, tracks=TracksConfig(kind))
        return Build(lambda: make(config), kind)

    @pytest.mark.parametrize("shape", SHAPES)
    @pytest.mark.parametrize("colour", [True, False])
    def test_predictions_have_the_shape_of_the_frame(
        self, build: Build, shape: tuple[int, int], colour: bool
    ) -> None:
        """Frames of any size, in colour or grey, give predictions of that size for every instant."""
        frames = moving_texture(4, *shape)
        frames = frames if colour else [frame.without_chroma() for frame in frames]
        predictions = build.method().predict(references_of(frames), build.points(frames), [11, 12])
        assert len(predictions) == 2
        for prediction in predictions:
            check(prediction, frames[0])
            check_chroma(prediction.chroma, frames[0])

    @pytest.mark.parametrize("shape", SHAPES)
    def test_refinement_keeps_the_contract(self, build: Build, shape: tuple[int, int]) -> None:
        """A refiner takes partly decoded luma any number of times, and knows chroma at the end."""
        frames = moving_texture(3, *shape)
        [prediction] = build.method().predict(references_of(frames), build.points(frames), [11])
        refiner = prediction.refiner
        for _ in range(7):
            if refiner is None:
                return
            refined = refiner.refine(frames[1].luma)
            check(refined, frames[0])
            refiner = refined.refiner
        assert refiner is not None
        check_chroma(refiner.chroma(), frames[0])

    def test_predictions_are_deterministic(self, build: Build) -> None:
        """Two objects give the same bits, refined as well; the references are left as they were."""
        frames = moving_texture(3, 20, 28)
        kept = [frame.luma.copy() for frame in frames]
        outcomes = []
        for _ in range(2):
            [prediction] = build.method().predict(references_of(frames), build.points(frames), [11])
            refined = prediction.refiner.refine(frames[1].luma) if prediction.refiner else prediction
            outcomes.append((prediction.luma.tobytes(), refined.luma.tobytes()))
        assert outcomes[0] == outcomes[1]
        assert all(np.array_equal(a, frame.luma) for a, frame in zip(kept, frames, strict=True))

    def test_earlier_predictions_leave_no_trace(self, build: Build) -> None:
        """What a method predicted before does not change what it predicts next."""
        method, frames, others = build.method(), moving_texture(5, 20, 28), moving_texture(3, 33, 9, seed=5)
        method.predict(references_of(others), build.points(others), [11])
        [used] = method.predict(references_of(frames), build.points(frames), [12])
        [fresh] = build.method().predict(references_of(frames), build.points(frames), [12])
        np.testing.assert_array_equal(used.luma, fresh.luma)

    def test_identical_references_are_the_prediction(self, build: Build) -> None:
        """Where nothing moves, nothing changes."""
        frame = moving_texture(1, 24, 32)[0]
        frames = [frame, frame, frame]
        [prediction] = build.method().predict(references_of(frames), build.points(frames), [11])
        np.testing.assert_array_equal(to_uint8(prediction.luma), frame.luma)

    @pytest.mark.parametrize("values", [(0, 0), (255, 255), (16, 235)])
    def test_constant_frames_are_predicted(self, build: Build, values: tuple[int, int]) -> None:
        """Frames without any texture give values between theirs, without failing."""
        frames = [Frame(np.full((20, 24), value, np.uint8)) for value in values]
        sequence = [frames[0], frames[0], frames[1]]
        [prediction] = build.method().predict(references_of(sequence), build.points(sequence), [11])
        check(prediction, frames[0])
        assert min(values) <= to_uint8(prediction.luma).min()
        assert to_uint8(prediction.luma).max() <= max(values)

    def test_noise_and_scene_cuts_are_survived(self, build: Build) -> None:
        """References that have nothing in common give a prediction all the same."""
        a, b = moving_texture(1, 24, 32, seed=1)[0], moving_texture(1, 24, 32, seed=2)[0]
        [prediction] = build.method().predict(references_of([a, a, b]), build.points([a, a, b]), [11])
        check(prediction, a)
        assert psnr_db(to_uint8(prediction.luma), a.luma) < 40

    def test_more_references_than_two_are_accepted(self, build: Build) -> None:
        """Decoded frames inside the group serve as references beside the key frames."""
        frames = moving_texture(5, 24, 32)
        references = [ReferenceFrame(index, frames[index]) for index in (0, 2, 4)]
        for prediction in build.method().predict(references, build.points(frames), [1, 3]):
            check(prediction, frames[0])
