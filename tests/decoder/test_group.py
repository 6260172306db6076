"""Groups of pictures decoded in memory."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from decoder import group
from decoder.group import GroupDecoder, LevelBegins, RecordedGroup, single_prediction
from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.side_information.protocol import Prediction
from dvc.config import CODERS, CodecConfig, Qp, VideoConfig, codec_config
from dvc.errors import BitstreamError, DvcError
from dvc.slepian_wolf import Round, drive
from dvc.stream import Form
from dvc.video import Frame
from dvc.wynerziv.quantizer import FrameLayout
from tests.clips import moving_texture
from tests.streams import config_of, encoded, tasks_of


def test_unknown_methods_are_refused() -> None:
    config = codec_config(VideoConfig(16, 16, 25, 1), side_information={"method": "magic"})
    with pytest.raises(BitstreamError, match="'magic' is not installed; available: mci"):
        GroupDecoder(config)


def predicted(value: float = 7.0, shape: tuple[int, int] = (3, 5)) -> Prediction:
    return Prediction(np.full(shape, value), None, (np.zeros((3, 5)),), "of others")


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (None, "expected a list of one prediction for one instant"),
        ([], "expected a list of one prediction for one instant"),
        ([np.zeros((3, 5))], "expected a list of one prediction for one instant"),
        ([predicted(shape=(2, 5))], "expected predictions of 5x3, got 5x2"),
        ([predicted(np.nan)], "a prediction is not finite"),
        ([replace(predicted(), compensated=())], "expected a compensated reference at least"),
        ([replace(predicted(), luma=[7.0])], "expected arrays, got list"),
        ([replace(predicted(), alternatives=(np.zeros((1, 5)),))], "expected predictions of 5x3, got 5x1"),
        ([replace(predicted(), expected_error=np.zeros(15))], "expected predictions of 5x3, got 15"),
    ],
)
def test_a_method_of_others_that_errs_is_named(found: object, told: str) -> None:
    good = predicted()
    assert single_prediction([good], (3, 5), "mine") is good
    with pytest.raises(DvcError) as caught:
        single_prediction(found, (3, 5), "mine")
    assert str(caught.value) == f"side information 'mine': {told}"


Group = tuple[CodecConfig, GroupTask]


@pytest.fixture(scope="module", params=["cascade", "turbo"])
def config_and_task(request: pytest.FixtureRequest) -> Group:
    """Return a group of seven Wyner-Ziv frames, in three levels, as it is buffered."""
    video, gop = VideoConfig(32, 24, 25, 1, luma_only=True), {"length": 8, "references": "hierarchical"}
    coder = CODERS[request.param]()
    config = codec_config(video, "2d", Qp(32), gop=gop, key={"qp": 36}, coder=coder)
    stream = encoded(config, [Frame(frame.luma) for frame in moving_texture(9, 24, 32)])
    *_, task = tasks_of(stream)
    assert len(task.record.wyner_ziv) == 7
    return config_of(stream), task


def levels_of(config: CodecConfig, task: GroupTask) -> tuple[DecodedGroup, list[tuple[int, ...]]]:
    """Decode a group; return which of its frames were decoded in step, from 0 on."""
    record, levels = RecordedGroup(task, config), list[tuple[int, ...]]()

    def answer(asked: Round | LevelBegins) -> Sequence[np.ndarray]:
        if isinstance(asked, LevelBegins):
            levels.append(tuple(index - task.first_index for index in asked.frames))
        return record.answer(asked)

    return drive(GroupDecoder(config).steps(task), answer), levels


@pytest.mark.parametrize(
    ("most_px", "parts"),
    [(2**21, [(3,), (1, 5), (0, 2, 4, 6)]), (3 * 24 * 32, [(3,), (1, 5), (0, 2, 4), (6,)])],
)
def test_the_first_frame_of_a_level_has_the_bits_of_all(
    config_and_task: Group,
    monkeypatch: pytest.MonkeyPatch,
    most_px: int,
    parts: list[tuple[int, ...]],
) -> None:
    config, task = config_and_task
    layout = FrameLayout.of(config)
    monkeypatch.setattr(group, "MAX_LEVEL_PX", most_px)
    found, levels = levels_of(config, task)
    by_positions = GroupDecoder(config)._decoder.coder.by_positions
    assert levels == (parts if by_positions else [(index,) for part in parts for index in part])
    for level in levels:
        frames = [found.wyner_ziv[index] for index in level]
        paid = sum(frame.header_bits + frame.crc_bits + frame.parity_bits for frame in frames)
        assert paid == 8 * sum(len(frame.punctured) for frame in frames)
        assert 0 < frames[0].header_bits <= 8 * len(frames[0].punctured)
        for frame in frames[1:]:
            assert len(frame.punctured) == len(layout.read_header(frame.punctured).header)
            assert frame.header_bits == 8 * len(frame.punctured)
    assert found.record.wyner_ziv == tuple(frame.punctured for frame in found.wyner_ziv)
    again, _ = levels_of(config, replace(task, record=found.record, form=Form.PUNCTURED))
    assert again.record == found.record
    for ours, theirs in zip(found.frames, again.frames, strict=True):
        np.testing.assert_array_equal(ours.luma, theirs.luma)


def test_a_group_without_a_frame_before_it_is_refused(config_and_task: Group) -> None:
    config, task = config_and_task
    with pytest.raises(BitstreamError, match="Wyner-Ziv frames without a frame before them"):
        GroupDecoder(config).decode(replace(task, before=None))


@pytest.mark.parametrize("number", [0, 2, 5])
def test_bits_that_nobody_asks_for_are_refused(config_and_task: Group, number: int) -> None:
    config, task = config_and_task
    record = GroupDecoder(config).decode(task).record
    payloads = [*record.wyner_ziv]
    payloads[number] += b"\0"
    longer = replace(record, wyner_ziv=tuple(payloads))
    with pytest.raises(BitstreamError, match="made for other predictions"):
        GroupDecoder(config).decode(replace(task, record=longer, form=Form.PUNCTURED))
