"""What every side-information method must do, whatever it is given."""

from collections.abc import Callable

import numpy as np
import pytest

from decoder.side_information import METHODS
from decoder.side_information.protocol import Prediction, ReferenceFrame, SideInformationMethod
from dvc.config import CodecConfig, VideoConfig
from dvc.metrics import psnr_db
from dvc.video import Frame, chroma_shape
from dvc.wynerziv.transform import to_uint8
from tests.clips import moving_texture

SHAPES = [(1, 1), (1, 17), (3, 5), (4, 4), (16, 16), (17, 23), (40, 56)]
Build = Callable[[], SideInformationMethod]


@pytest.fixture(params=METHODS)
def build(request: pytest.FixtureRequest) -> Build:
    """Return what builds a method with default settings."""
    return lambda: METHODS[request.param](CodecConfig("3d", VideoConfig(56, 40, 25, 1)))


def references_of(frames: list[Frame]) -> list[ReferenceFrame]:
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
    assert prediction.method in METHODS


def check_chroma(chroma: tuple[np.ndarray, np.ndarray] | None, like: Frame) -> None:
    assert (chroma is None) == (like.chroma is None)
    for plane in chroma or ():
        assert plane.dtype == np.uint8
        assert plane.shape == chroma_shape(*like.luma.shape)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("colour", [True, False])
def test_predictions_have_the_shape_of_the_frame(build: Build, shape: tuple[int, int], colour: bool) -> None:
    """Frames of any size, in colour or grey, give predictions of that size for every instant, in order."""
    frames = moving_texture(4, *shape)
    frames = frames if colour else [frame.without_chroma() for frame in frames]
    predictions = build().predict(references_of(frames), None, [11, 12])
    assert len(predictions) == 2
    for prediction in predictions:
        check(prediction, frames[0])
        check_chroma(prediction.chroma, frames[0])


@pytest.mark.parametrize("shape", SHAPES)
def test_refinement_keeps_the_contract(build: Build, shape: tuple[int, int]) -> None:
    """A refiner takes partly decoded luma any number of times, and knows chroma at the end."""
    frames = moving_texture(3, *shape)
    [prediction] = build().predict(references_of(frames), None, [11])
    refiner = prediction.refiner
    for _ in range(7):
        if refiner is None:
            return
        refined = refiner.refine(frames[1].luma)
        check(refined, frames[0])
        refiner = refined.refiner
    assert refiner is not None
    check_chroma(refiner.chroma(), frames[0])


def test_predictions_are_deterministic(build: Build) -> None:
    """Two objects give the same bits, refined as well; the references are left as they were."""
    frames = moving_texture(3, 20, 28)
    kept = [frame.luma.copy() for frame in frames]
    outcomes = []
    for _ in range(2):
        [prediction] = build().predict(references_of(frames), None, [11])
        refined = prediction.refiner.refine(frames[1].luma) if prediction.refiner else prediction
        outcomes.append((prediction.luma.tobytes(), refined.luma.tobytes()))
    assert outcomes[0] == outcomes[1]
    assert all(np.array_equal(a, frame.luma) for a, frame in zip(kept, frames, strict=True))


def test_earlier_predictions_leave_no_trace(build: Build) -> None:
    """What a method predicted before does not change what it predicts next."""
    method, frames = build(), moving_texture(5, 20, 28)
    method.predict(references_of(moving_texture(3, 33, 9, seed=5)), None, [11])
    [used] = method.predict(references_of(frames), None, [12])
    [fresh] = build().predict(references_of(frames), None, [12])
    np.testing.assert_array_equal(used.luma, fresh.luma)


def test_identical_references_are_the_prediction(build: Build) -> None:
    """Where nothing moves, nothing changes."""
    frame = moving_texture(1, 24, 32)[0]
    [prediction] = build().predict(references_of([frame, frame, frame]), None, [11])
    np.testing.assert_array_equal(to_uint8(prediction.luma), frame.luma)


@pytest.mark.parametrize("values", [(0, 0), (255, 255), (16, 235)])
def test_constant_frames_are_predicted(build: Build, values: tuple[int, int]) -> None:
    """Frames without any texture give values between theirs, without failing."""
    frames = [Frame(np.full((20, 24), value, np.uint8)) for value in values]
    [prediction] = build().predict(references_of([frames[0], frames[0], frames[1]]), None, [11])
    check(prediction, frames[0])
    assert min(values) <= to_uint8(prediction.luma).min()
    assert to_uint8(prediction.luma).max() <= max(values)


def test_noise_and_scene_cuts_are_survived(build: Build) -> None:
    """References that have nothing in common give a prediction all the same."""
    a, b = moving_texture(1, 24, 32, seed=1)[0], moving_texture(1, 24, 32, seed=2)[0]
    [prediction] = build().predict(references_of([a, a, b]), None, [11])
    check(prediction, a)
    assert psnr_db(to_uint8(prediction.luma), a.luma) < 40


def test_more_references_than_two_are_accepted(build: Build) -> None:
    """Decoded frames inside the group serve as references beside the key frames."""
    frames = moving_texture(5, 24, 32)
    references = [ReferenceFrame(index, frames[index]) for index in (0, 2, 4)]
    for prediction in build().predict(references, None, [1, 3]):
        check(prediction, frames[0])
