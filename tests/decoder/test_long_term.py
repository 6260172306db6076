"""Groups that are predicted from an earlier key frame, too: a camera that goes away and comes back."""

import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from decoder.session import stream_tasks
from decoder.tasks import DecodedGroup
from dvc.config import CodecConfig, GopConfig, VideoConfig, codec_config, key_lambda
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord, LongTermReference, StreamReader
from dvc.video import Frame
from encoder import intra_decision
from encoder.session import EncoderSession
from tests.clips import moving_texture
from tests.streams import decoded, written

NUM_AWAY = 13


def config_of(long_term_groups: int) -> CodecConfig:
    return codec_config(
        VideoConfig(128, 96, 25, 1), gop=GopConfig(4, "hierarchical", 2, 64, long_term_groups)
    )


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Return a camera that pans, and pans back a pixel beside."""
    away = moving_texture(60, 96, 128, (0.0, 12.0))[:NUM_AWAY]
    back = [Frame(np.roll(frame.luma, 1, axis=0), frame.chroma) for frame in away[-2::-1]]
    return [*away, *back]


def encoded(frames: Sequence[Frame], config: CodecConfig) -> bytes:
    file = io.BytesIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(intra_decision, "MAX_LOST_SHARE", 0.1)
        EncoderSession(config).write(frames, file, lambda _: None)
    return file.getvalue()


@pytest.fixture(scope="module")
def stream(frames: list[Frame]) -> bytes:
    """Return its buffered stream."""
    return encoded(frames, config_of(64))


def lumas(groups: Sequence[DecodedGroup]) -> dict[int, bytes]:
    return {
        group.first_index + k: frame.luma.tobytes()
        for group in groups
        for k, frame in enumerate(group.frames)
    }


def test_what_comes_back_needs_no_key_frame(frames: list[Frame], stream: bytes) -> None:
    """On the way back groups name key frames of the way there, which saves more than it costs."""
    groups = decoded(stream)
    named = [group.record.long_term for group in groups]
    assert not any(named[: NUM_AWAY // 4])
    assert sum(map(bool, named)) >= 2
    with_keys = decoded(encoded(frames, config_of(0)))
    assert not any(group.record.long_term for group in with_keys)
    config = StreamReader(io.BytesIO(stream)).config
    costs = []
    for found in (groups, with_keys):
        size = len(written(config, [group.record for group in found], Form.PUNCTURED))
        pictures = [frame.luma.astype(float) for group in found for frame in group.frames]
        error = sum(((p - f.luma) ** 2).sum() for p, f in zip(pictures, frames, strict=True))
        costs.append(error + 4 * key_lambda(config.wyner_ziv.qp) * 8 * size)
    assert costs[0] < 0.85 * costs[1]


def test_all_ways_of_decoding_agree(stream: bytes) -> None:
    """In any number of processes, of what was needed alone, and from the middle on."""
    groups = decoded(stream)
    whole = lumas(groups)
    assert lumas(decoded(stream, 3)) == whole
    reader = StreamReader(io.BytesIO(stream))
    assert lumas(decoded(written(reader.config, [g.record for g in groups], Form.PUNCTURED))) == whole
    found = lumas(decoded(stream, wanted=range(20, 22)))
    assert {20, 21} <= set(found)
    assert all(whole[index] == luma for index, luma in found.items())


def test_key_frames_that_cannot_be_meant_are_refused(stream: bytes) -> None:
    """Before the first group, of a group that no key frame ends, and the group itself."""
    reader = StreamReader(io.BytesIO(stream))
    records = list(reader)
    number = next(k for k, record in enumerate(records) if record.long_term)
    own = records[number].long_term
    assert own is not None
    following = next(k for k, record in enumerate(records[number + 1 :], number + 1) if record.without_key)
    for place, back in ((number, number + 1), (number, 0), (following, following - number)):
        changed = list(records)
        matches = LongTermReference(back, own.matches)
        changed[place] = GopRecord(
            records[place].num_frames,
            b"",
            records[place].tracks or b"t",
            records[place].wyner_ziv,
            long_term=matches,
        )
        damaged = StreamReader(io.BytesIO(written(reader.config, changed, Form.BUFFERED)))
        message = (
            f"group of pictures {place}: long-term reference: no key frame that may be one {back} groups"
        )
        with pytest.raises(BitstreamError, match=message):
            list(stream_tasks(damaged.config, damaged))


def test_old_key_frames_are_forgotten(stream: bytes) -> None:
    """A stream says how far back they may be."""
    reader = StreamReader(io.BytesIO(stream))
    records = list(reader)
    most = max(record.long_term.groups_back for record in records if record.long_term)
    for groups, fails in ((most, False), (most - 1, True)):
        config = replace(reader.config, gop=replace(reader.config.gop, long_term_groups=groups))
        near = StreamReader(io.BytesIO(written(config, records, Form.BUFFERED)))
        if fails:
            with pytest.raises(BitstreamError, match=f"no key frame that may be one {most} groups back"):
                list(stream_tasks(near.config, near))
        else:
            assert list(stream_tasks(near.config, near))
