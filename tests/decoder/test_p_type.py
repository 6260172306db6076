"""Groups without key frame: chains of groups from one key frame to the next."""

import io
from collections.abc import Sequence

import pytest

from decoder.session import decode_stream, stream_tasks
from decoder.tasks import DecodedGroup
from dvc.config import GopConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.metrics import psnr_db
from dvc.stream import Form, GopRecord, StreamReader
from dvc.video import Frame
from encoder import intra_decision
from encoder.session import EncoderSession
from tests.clips import moving_texture
from tests.streams import decoded, written

NUM_FRAMES = 20
CONFIG = codec_config(VideoConfig(96, 64, 25, 1), gop=GopConfig(4, "hierarchical", 2, 8))


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Return an original whose camera turns slowly."""
    return moving_texture(NUM_FRAMES, 64, 96, (0.0, 0.5))


@pytest.fixture(scope="module")
def stream(frames: list[Frame]) -> bytes:
    """Return its buffered stream."""
    file = io.BytesIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(intra_decision, "MAX_LOST_SHARE", 1e9)  # key frames as rarely as they may come
        EncoderSession(CONFIG).write(frames, file, lambda _: None)
    return file.getvalue()


@pytest.fixture(scope="module")
def groups(stream: bytes) -> list[DecodedGroup]:
    """Return what is decoded of it."""
    return decoded(stream)


def planes_of(groups: Sequence[DecodedGroup]) -> list[bytes]:
    return [
        plane.tobytes()
        for group in groups
        for frame in group.frames
        for plane in (frame.luma, *(frame.chroma or ()))
    ]


def test_key_frames_come_when_the_period_is_over(groups: list[DecodedGroup]) -> None:
    """Two groups do without, the third may not; all frames are there."""
    assert [group.key is None for group in groups] == [False, True, True, False, True, True]
    assert [group.last.index for group in groups] == [0, 4, 8, 12, 16, 19]
    assert [len(group.frames) for group in groups] == [1, 4, 4, 4, 4, 3]


def test_p_type_frames_are_as_good_as_key_frames(groups: list[DecodedGroup], frames: list[Frame]) -> None:
    """Nothing drifts; what predicted them is told."""
    quality = [
        psnr_db(original.luma, frame.luma)
        for original, frame in zip(frames, (frame for group in groups for frame in group.frames), strict=True)
    ]
    assert min(quality) > quality[0] - 4.0
    assert [frame.method == "p-type" for frame in groups[1].wyner_ziv] == [False, True, False, True]


@pytest.mark.parametrize("jobs", [2, 5])
def test_chains_decode_alike_in_any_number_of_processes(
    stream: bytes, groups: list[DecodedGroup], jobs: int
) -> None:
    """A group begins where the last frame of the one before is known, wherever that is."""
    assert planes_of(decoded(stream, jobs)) == planes_of(groups)


def test_what_was_needed_decodes_to_the_same(stream: bytes, groups: list[DecodedGroup]) -> None:
    """The punctured form has the same frames, and is smaller."""
    config = StreamReader(io.BytesIO(stream)).config
    punctured = written(config, [group.record for group in groups], Form.PUNCTURED)
    assert len(punctured) < len(stream)
    assert planes_of(decoded(punctured)) == planes_of(groups)


@pytest.mark.parametrize("wanted", [range(3, 4), range(8, 9), range(9, 12), range(13, 20), range(19, 20)])
def test_any_frames_may_be_sought(stream: bytes, groups: list[DecodedGroup], wanted: range) -> None:
    """Decoding starts at the key frame that they depend on."""
    whole = {
        group.first_index + k: frame.luma.tobytes()
        for group in groups
        for k, frame in enumerate(group.frames)
    }
    found = {
        group.first_index + k: frame.luma.tobytes()
        for group in decoded(stream, wanted=wanted)
        for k, frame in enumerate(group.frames)
    }
    assert set(wanted) <= set(found)
    assert all(whole[index] == luma for index, luma in found.items())


def test_chains_end_with_key_frames(stream: bytes) -> None:
    """From the frame after one key frame to the next."""
    reader = StreamReader(io.BytesIO(stream))
    chains = [[task.number for task in chain] for chain in stream_tasks(reader.config, reader)]
    assert chains == [[0], [1, 2, 3], [4, 5]]


def test_groups_before_damage_are_decoded(stream: bytes, groups: list[DecodedGroup]) -> None:
    """Those of a chain, too, whose end is lost."""
    reader = StreamReader(io.BytesIO(stream))
    cut = stream[: reader.index.entries[5].offset + 9]
    source = StreamReader(io.BytesIO(cut))
    found = []
    with pytest.raises(BitstreamError, match="record 6"):
        found.extend(decode_stream(source.config, source))
    source = StreamReader(io.BytesIO(cut))
    remaining = decode_stream(source.config, source)
    assert planes_of([next(remaining) for _ in range(5)]) == planes_of(groups[:5])


def test_key_frames_may_not_be_missing(stream: bytes, groups: list[DecodedGroup]) -> None:
    """Neither the first, nor for longer than the period, nor where the configuration has no P-type frames."""
    reader = StreamReader(io.BytesIO(stream))
    config, records = reader.config, list(reader)
    with pytest.raises(BitstreamError, match="without a key frame where there can be none"):
        decoded(written(config, [GopRecord(1, b"", b"", (b"x",))], Form.BUFFERED))
    endless = [records[0], records[1], records[2], records[1]]
    with pytest.raises(BitstreamError, match="group of pictures 3: key frame: none since 12 frames"):
        decoded(written(config, endless, Form.BUFFERED))
