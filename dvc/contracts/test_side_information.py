"""Contract of a method of side information."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import Prediction, ReferenceFrame, SideInformationMethod
from dvc import extensions
from dvc.config import CodecConfig, TracksConfig, VideoConfig, codec_config
from dvc.metrics import psnr_db
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame, chroma_shape
from dvc.wynerziv.transform import to_uint8
from encoder.corner_detector import CornerDetector
from encoder.point_tracker import PointTracker

SHAPES = pytest.mark.parametrize("shape", [(1, 1), (1, 17), (3, 5), (4, 4), (16, 16), (17, 23), (40, 56)])
CODECS = {"3d": "none", "3d-te": "encoder", "3d-td": "decoder"}
"""Codecs by the kind of points that they send."""
FIRST = 10
"""Index of the first frame."""
Points = PointTracks | FeaturePoints | None
Make = Callable[[CodecConfig], SideInformationMethod]


def moving_texture(
    num_frames: int, height: int, width: int, motion_px: tuple[float, float] = (1.0, 2.0), seed: int = 0
) -> list[Frame]:
    """Return frames of a smooth random texture under a constant translation."""
    rng = np.random.default_rng(seed)
    margin = 4 * num_frames + 8
    fine = gaussian_filter(rng.normal(size=(height + 2 * margin, width + 2 * margin)), 1.2)
    coarse = gaussian_filter(rng.normal(size=fine.shape), 6.0)
    texture = 128.0 + 30.0 * fine / fine.std() + 25.0 * coarse / coarse.std()
    rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    half = chroma_shape(height, width)
    frames = []
    for index in range(num_frames):
        down, right = (component * index for component in motion_px)
        sampled = map_coordinates(texture, [rows + margin - down, columns + margin - right], order=3)
        luma = np.clip(np.round(sampled), 16, 235).astype(np.uint8)
        frames.append(Frame(luma, (np.full(half, 110, np.uint8), np.full(half, 140 + index % 8, np.uint8))))
    return frames


class Subject(NamedTuple):
    """Method under test in a codec."""

    make: Callable[[], SideInformationMethod]
    kind: str  # kind of points that the codec sends

    def predict(
        self, frames: list[Frame], *inner: int, method: SideInformationMethod | None = None
    ) -> list[Prediction]:
        """Predict frames by their positions from the first and the last frame."""
        references = [ReferenceFrame(FIRST + index, frames[index]) for index in (0, len(frames) - 1)]
        instants = [FIRST + index for index in inner]
        return (method or self.make()).predict(references, self.points(frames), instants)

    def points(self, frames: list[Frame], num_points: int = 40) -> Points:
        """Return the points of all frames: tracked at the encoder, corners of each frame, or none."""
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


def check(prediction: Prediction, like: Frame) -> None:
    """Check types, shapes and ranges of a prediction against a frame of the sequence."""
    errors = [] if prediction.expected_error is None else [prediction.expected_error]
    for plane in (prediction.luma, *prediction.compensated, *errors):
        assert plane.dtype == np.float64
        assert plane.shape == like.luma.shape
        assert np.isfinite(plane).all()
    assert len(prediction.compensated) >= 1
    assert prediction.luma.min() >= 0
    assert prediction.luma.max() <= 255
    assert prediction.success == (prediction.reason == "")
    assert prediction.method


def check_chroma(chroma: tuple[np.ndarray, np.ndarray] | None, like: Frame) -> None:
    """Check that predictions of frames in colour have chroma of the right size, and only those."""
    assert (chroma is None) == (like.chroma is None)
    for plane in chroma or ():
        assert plane.dtype == np.uint8
        assert plane.shape == chroma_shape(*like.luma.shape)


class SideInformationContract:
    """Tests of a method; a derived class defines the fixture `make`, which returns its factory."""

    @pytest.fixture(params=CODECS)
    def subject(self, request: pytest.FixtureRequest, make: Make) -> Subject:
        """Return the method in a codec."""
        kind = CODECS[request.param]
        config = codec_config(VideoConfig(56, 40, 25, 1), request.param, tracks=TracksConfig(kind))
        return Subject(lambda: make(config), kind)

    @SHAPES
    @pytest.mark.parametrize("colour", [True, False])
    def test_predictions_have_the_shape_of_the_frame(
        self, subject: Subject, shape: tuple[int, int], colour: bool
    ) -> None:
        """Frames of any size, in colour or grey, give predictions of that size for every instant."""
        frames = [frame if colour else frame.without_chroma() for frame in moving_texture(4, *shape)]
        predictions = subject.predict(frames, 1, 2)
        assert len(predictions) == 2
        for prediction in predictions:
            check(prediction, frames[0])
            check_chroma(prediction.chroma, frames[0])

    @SHAPES
    def test_refinement_keeps_the_contract(self, subject: Subject, shape: tuple[int, int]) -> None:
        """A refiner takes partly decoded luma any number of times, and has chroma at the end."""
        frames = moving_texture(3, *shape)
        refiner = subject.predict(frames, 1)[0].refiner
        if refiner is None:
            return
        for _ in range(7):
            refined = refiner.refine(frames[1].luma)
            check(refined, frames[0])
            if refined.refiner is None:
                return
            refiner = refined.refiner
        check_chroma(refiner.chroma(), frames[0])

    def test_predictions_are_deterministic(self, subject: Subject) -> None:
        """Two objects give the same bits, also refined; the references are unchanged."""
        frames = moving_texture(3, 20, 28)
        copies, outcomes = [frame.luma.copy() for frame in frames], set()
        for _ in range(2):
            [prediction] = subject.predict(frames, 1)
            refined = prediction.refiner.refine(frames[1].luma) if prediction.refiner else prediction
            outcomes.add((prediction.luma.tobytes(), refined.luma.tobytes()))
        assert len(outcomes) == 1
        assert all(np.array_equal(copy, frame.luma) for copy, frame in zip(copies, frames, strict=True))

    def test_earlier_predictions_leave_no_trace(self, subject: Subject) -> None:
        """A prediction does not depend on those before it."""
        method, frames = subject.make(), moving_texture(5, 20, 28)
        subject.predict(moving_texture(3, 33, 9, seed=5), 1, method=method)
        [used] = subject.predict(frames, 2, method=method)
        [fresh] = subject.predict(frames, 2)
        np.testing.assert_array_equal(used.luma, fresh.luma)

    def test_identical_references_are_the_prediction(self, subject: Subject) -> None:
        """If nothing moves, nothing changes."""
        frame = moving_texture(1, 24, 32)[0]
        [prediction] = subject.predict([frame] * 3, 1)
        np.testing.assert_array_equal(to_uint8(prediction.luma), frame.luma)

    @pytest.mark.parametrize("values", [(0, 0), (255, 255), (16, 235)])
    def test_constant_frames_are_predicted(self, subject: Subject, values: tuple[int, int]) -> None:
        """Frames without any texture give values between theirs."""
        first, last = (Frame(np.full((20, 24), value, np.uint8)) for value in values)
        [prediction] = subject.predict([first, first, last], 1)
        check(prediction, first)
        assert min(values) <= to_uint8(prediction.luma).min()
        assert to_uint8(prediction.luma).max() <= max(values)

    def test_scene_cuts_are_survived(self, subject: Subject) -> None:
        """References that have nothing in common also give a prediction."""
        a, b = moving_texture(1, 24, 32, seed=1)[0], moving_texture(1, 24, 32, seed=2)[0]
        [prediction] = subject.predict([a, a, b], 1)
        check(prediction, a)
        assert psnr_db(to_uint8(prediction.luma), a.luma) < 40

    def test_more_references_than_two_are_accepted(self, subject: Subject) -> None:
        """Decoded frames inside the group are references like the key frames."""
        frames = moving_texture(5, 24, 32)
        references = [ReferenceFrame(index, frames[index]) for index in (0, 2, 4)]
        for prediction in subject.make().predict(references, subject.points(frames), [1, 3]):
            check(prediction, frames[0])


class TestInstalledMethods(SideInformationContract):
    """Methods of side information that are installed."""

    @pytest.fixture(params=extensions.installed(extensions.SIDE_INFORMATION))
    def make(self, request: pytest.FixtureRequest) -> Make:
        """Return the factory of a method."""
        return METHODS[request.param]
