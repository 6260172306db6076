"""Groups that are encoded before there is room for them: they come back as they were."""

from pathlib import Path

import numpy as np
import pytest

from dvc.config import DiscoverMatrix, Live, Qp, Quality, VideoConfig, codec_config
from dvc.video import Frame
from encoder.frame_queue import FrameQueue
from encoder.groups_ahead import GroupsAhead
from encoder.kept_groups import KeptGroup
from encoder.session import EncoderSession
from encoder.spool import Spool
from tests.clips import moving_texture
from tests.waiting import wait_until

FRAMES = [Frame(frame.luma) for frame in moving_texture(17, 24, 32)]


@pytest.mark.parametrize("memory_bytes", [0, 2**20])
@pytest.mark.parametrize("quality", [Qp(24), DiscoverMatrix(8)], ids=["embedded", "over range"])
def test_groups_come_back_whole(tmp_path: Path, memory_bytes: int, quality: Quality) -> None:
    """Records and planes; from memory as from the file."""
    config = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "3d-te", quality)
    session = EncoderSession(config, Live())
    groups = [
        KeptGroup(number, number * 10, session.encode(group))
        for number, group in enumerate(session.groups(FRAMES))
    ]
    with Spool(str(tmp_path / "spool"), 2**20, memory_bytes) as held:
        ahead = GroupsAhead(held, FrameQueue(FRAMES, 20), session.config)
        for group in groups:
            ahead.add(group)
        for group in groups:
            found = ahead.take()
            assert found is not None
            assert (found.number, found.first_frame) == (group.number, group.first_frame)
            assert found.encoded.record == group.encoded.record
            for frame, same in zip(group.encoded.frames, found.encoded.frames, strict=True):
                assert np.array_equal(frame.words, same.words)
                assert same.words.flags.writeable  # there are no kernels of others
                assert frame.quantization == same.quantization
        assert ahead.take() is None
        assert bool(held.report.most_on_disk) == (memory_bytes == 0)


def test_groups_are_encoded_ahead_when_their_frames_have_come(tmp_path: Path) -> None:
    """So that answers do not wait for a camera; and what the file cannot take is not encoded."""
    config = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")
    with Spool(str(tmp_path / "spool"), 2**20, 0) as held:
        queue = FrameQueue(FRAMES, 20)
        ahead = GroupsAhead(held, queue, config)
        wait_until(lambda: ahead.can_grow)
        for _ in FRAMES[1:]:
            next(queue)
        wait_until(lambda: ahead.can_grow)  # the end has come: nothing is waited for
        queue.close()
