"""Groups before and after decoding: what goes from one to the next, and what a record keeps."""

from dataclasses import replace

import numpy as np
import pytest

from decoder.side_information.protocol import ReferenceFrame
from decoder.tasks import DecodedFrame, DecodedGroup, GroupTask, frames_digest, naming_group
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord
from dvc.video import Frame


def frame_of(level: int, colour: bool = False) -> Frame:
    """Return a flat frame."""
    chroma = np.full((4, 4), level, np.uint8)
    return Frame(np.full((8, 8), level, np.uint8), (chroma, chroma + 1) if colour else None)


def decoded(index: int, colour: bool = False) -> DecodedFrame:
    """Return a frame that took nine bytes."""
    frame = frame_of(10 * index, colour)
    return DecodedFrame(index, frame, frame.luma, frame.luma, "test", "", 3, 16, 40, 0, 0, punctured=bytes(9))


def task_of(form: Form) -> GroupTask:
    """Return a group of two frames and a key frame."""
    record = GopRecord(3, b"key", True, b"tracks", (b"a" * 30, b"b" * 40))
    return GroupTask(b"", 1, 5, ReferenceFrame(4, frame_of(1)), frame_of(70), record, form)


def test_records_hold_what_was_needed() -> None:
    """Payloads of the punctured form and the digest of the frames; a no-feedback record stays as it is."""
    frames = decoded(5), decoded(6)
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
    """Of luma, of chroma, and of their order."""
    frames = [decoded(1, True), decoded(2, True)]
    other = replace(frames[1], frame=Frame(frames[1].frame.luma, (frame_of(0).luma[:4, :4],) * 2))
    found = [frames_digest(some) for some in (frames, frames[::-1], frames[:1], [frames[0], other])]
    assert len(set(found)) == 4
    assert frames_digest(list(frames)) == found[0]


def test_damage_is_named_by_its_group() -> None:
    """And by the part of it; other errors pass."""
    with (
        pytest.raises(BitstreamError, match="group of pictures 7: tracks: too short"),
        naming_group(7, "tracks: "),
    ):
        raise BitstreamError("too short")
    with pytest.raises(KeyError), naming_group(7):
        raise KeyError
