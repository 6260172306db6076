"""Groups before and after decoding: what goes from one to the next, and what a record keeps."""

import io
from dataclasses import replace

import numpy as np
import pytest

from decoder.group_tasks import (
    MAX_NAMED,
    DecodedFrame,
    DecodedGroup,
    GroupTask,
    Losses,
    frames_digest,
    naming_group,
)
from decoder.session import decode_stream
from decoder.side_information.protocol import ReferenceFrame
from dvc.config import GopConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord, StreamReader
from dvc.video import Frame
from tests.clips import moving_texture
from tests.streams import decoded, encoded, written


def frame_of(level: int, colour: bool = False) -> Frame:
    chroma = np.full((4, 4), level, np.uint8)
    return Frame(np.full((8, 8), level, np.uint8), (chroma, chroma + 1) if colour else None)


def decoded_frame(index: int, colour: bool = False) -> DecodedFrame:
    frame = frame_of(10 * index, colour)
    return DecodedFrame(index, frame, frame.luma, frame.luma, "test", "", 3, 16, 40, 0, 0, punctured=bytes(9))


def task_of(form: Form) -> GroupTask:
    record = GopRecord(3, b"key", True, b"tracks", (b"a" * 30, b"b" * 40))
    return GroupTask(b"", 1, 5, ReferenceFrame(4, frame_of(1)), frame_of(70), record, form)


def test_records_hold_what_was_needed() -> None:
    frames = decoded_frame(5), decoded_frame(6)
    task = task_of(Form.BUFFERED)
    group = DecodedGroup.of(task, frames)
    assert group.record.wyner_ziv == (bytes(9), bytes(9))
    assert group.record.digest == frames_digest(frames)
    assert (group.record.key, group.record.predicted, group.record.tracks) == (b"key", True, b"tracks")
    assert group.frames == [frames[0].frame, frames[1].frame, task.key]
    assert task.last_index == 7
    no_feedback = task_of(Form.NO_FEEDBACK)
    assert DecodedGroup.of(no_feedback, frames).record == no_feedback.record


def test_digests_tell_samples_apart() -> None:
    frames = [decoded_frame(1, True), decoded_frame(2, True)]
    other = replace(frames[1], frame=Frame(frames[1].frame.luma, (frame_of(0).luma[:4, :4],) * 2))
    found = [frames_digest(some) for some in (frames, frames[::-1], frames[:1], [frames[0], other])]
    assert len(set(found)) == 4
    assert frames_digest(list(frames)) == found[0]


def test_damage_is_named_by_its_group() -> None:
    with (
        pytest.raises(BitstreamError, match="group of pictures 7: tracks: too short"),
        naming_group(7, "tracks: "),
    ):
        raise BitstreamError("too short")
    with pytest.raises(KeyError), naming_group(7):
        raise KeyError


CONFIG = codec_config(VideoConfig(48, 32, 25, 1), "2d", gop=GopConfig(3), key={"intra_period": 10, "qp": 34})
"""Key frames are 0, 3, 6 and so on; of these 0, 12 and 24 are IDR pictures."""


@pytest.fixture(scope="module")
def stream() -> bytes:
    return encoded(CONFIG, moving_texture(30, 32, 48, (0.5, 0.5)))


def flipped(stream: bytes, *numbers: int) -> bytes:
    damaged = bytearray(stream)
    with StreamReader(io.BytesIO(stream)) as reader:
        for entry in (reader.index.entries[number] for number in numbers):
            damaged[entry.offset + entry.size // 2] ^= 0x55
    return bytes(damaged)


def salvaged(stream: bytes, jobs: int = 1, wanted: range | None = None) -> tuple[dict[int, bytes], str]:
    """Return luma of the frames that are left, by place, and what is said of the others."""
    reader, losses = StreamReader(io.BytesIO(stream)), Losses(wanted)
    groups = list(decode_stream(reader.config, reader, jobs, wanted, losses=losses))
    found = {
        group.first_index + place: frame.luma.tobytes()
        for group in groups
        for place, frame in enumerate(group.frames)
    }
    return found, str(losses.error(len(found)) or "")


@pytest.mark.parametrize(
    ("damaged", "lost", "said"),
    [
        ([], [], []),
        ([0], [*range(12)], ["frames 0 to 11: record 1 "]),
        ([2], [*range(4, 12)], ["frames 4 to 11: record 3 "]),
        ([4], [*range(10, 24)], ["frames 10 to 23: record 5 "]),
        ([10], [*range(28, 30)], ["frames 28 to 29: record 11 "]),
        (
            [3, 9],
            [*range(7, 12), *range(25, 30)],
            ["frames 7 to 11: record 4 ", "frames 25 to 29: record 10 "],
        ),
    ],
)
@pytest.mark.parametrize("jobs", [1, 2])
def test_damage_costs_a_chain(
    stream: bytes, damaged: list[int], lost: list[int], said: list[str], jobs: int
) -> None:
    whole = dict(enumerate(frame.luma.tobytes() for group in decoded(stream) for frame in group.frames))
    found, message = salvaged(flipped(stream, *damaged), jobs)
    assert found == {place: luma for place, luma in whole.items() if place not in lost}
    parts = message.removeprefix("lost: ").split("; ")
    assert len(parts) == max(len(said), 1)
    assert all(part.startswith(beginning) for part, beginning in zip(parts, said, strict=False))
    assert bool(message) == bool(damaged)


def test_damage_of_other_frames_costs_these(stream: bytes) -> None:
    whole, _ = salvaged(stream)
    reader = StreamReader(io.BytesIO(stream))
    records = list(reader)
    payloads = records[1].wyner_ziv
    records[1] = replace(records[1], wyner_ziv=(payloads[0][:1], *payloads[1:]))
    broken = flipped(written(reader.config, records, Form.BUFFERED), 9)
    found, message = salvaged(broken, 2)
    assert found == {place: luma for place, luma in whole.items() if place not in (1, 2, *range(25, 30))}
    assert message.startswith("lost: frames 1 to 2: group of pictures 1: ")
    assert "; frames 25 to 29: record 10 " in message


def test_nothing_is_said_of_frames_that_nobody_wants(stream: bytes) -> None:
    whole, _ = salvaged(stream)
    for wanted in (range(14, 17), range(20, 26), range(25, 30)):
        found, message = salvaged(flipped(stream, 2), wanted=wanted)
        assert message == ""
        assert set(wanted) <= set(found)
        assert found.items() <= whole.items()
    found, message = salvaged(flipped(stream, 2), wanted=range(10, 14))
    assert message.startswith("lost: frames 10 to 11: ")
    assert {12, 13} <= set(found)


def test_messages_are_short() -> None:
    losses = Losses()
    for first in range(0, 200, 4):
        losses.add(range(first + 1, first + 2), "other")
        losses.add(range(first, first + 1), "damage")
    message = str(losses.error(7))
    assert message.startswith("lost: frames 0 to 1: damage; frames 4 to 5: damage; ")
    assert message.count("damage") == MAX_NAMED
    assert message.endswith(f"{50 - MAX_NAMED} more runs of frames (frames kept: 7)")
