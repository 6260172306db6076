"""Streams whose key frames are predicted: any part of them, in any number of processes, and hostile ones."""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import decoder.__main__ as decoder
from decoder.group_tasks import DecodedGroup
from decoder.session import stream_tasks
from dvc.config import GopConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.metrics import psnr_db
from dvc.stream import Form, StreamReader
from tests.clips import moving_texture
from tests.streams import config_of, decoded, encoded, tasks_of, written

WIDTH, HEIGHT, NUM_FRAMES, LENGTH = 48, 32, 30, 3
CONFIG = codec_config(
    VideoConfig(WIDTH, HEIGHT, 25, 1), "2d", gop=GopConfig(LENGTH), key={"intra_period": 10, "qp": 34}
)
FRAMES = [
    *moving_texture(13, HEIGHT, WIDTH, (0.5, 0.5)),  # up to a key frame
    *moving_texture(NUM_FRAMES - 13, HEIGHT, WIDTH, (0.0, 1.0)),
]


@pytest.fixture(scope="module")
def stream() -> bytes:
    return encoded(CONFIG, FRAMES)


@pytest.fixture(scope="module")
def groups(stream: bytes) -> list[DecodedGroup]:
    return decoded(stream)


def planes_of(groups: Sequence[DecodedGroup]) -> dict[int, list[bytes]]:
    """Return the planes of all frames, by their places."""
    return {
        group.first_index + place: [plane.tobytes() for plane in (frame.luma, *(frame.chroma or ()))]
        for group in groups
        for place, frame in enumerate(group.frames)
    }


def test_chains_have_their_length(groups: list[DecodedGroup]) -> None:
    assert "".join("IP"[group.record.predicted] for group in groups) == "IPPPIPPPIPP"
    found = [frame for group in groups for frame in group.frames]
    quality = [psnr_db(one.luma, other.luma) for one, other in zip(FRAMES, found, strict=True)]
    assert min(quality) > np.mean(quality) - 6.0


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_any_number_of_jobs_gives_the_same(stream: bytes, groups: list[DecodedGroup], jobs: int) -> None:
    assert planes_of(decoded(stream, jobs)) == planes_of(groups)
    config = config_of(stream)
    punctured = written(config, [group.record for group in groups], Form.PUNCTURED)
    assert len(punctured) < len(stream)
    again = decoded(punctured, jobs)
    assert planes_of(again) == planes_of(groups)
    assert written(config, [group.record for group in again], Form.PUNCTURED) == punctured


def test_every_part_is_that_of_the_whole(stream: bytes, groups: list[DecodedGroup]) -> None:
    whole = planes_of(groups)
    for first in range(NUM_FRAMES):
        wanted = range(first, min(first + 2, NUM_FRAMES))
        found = planes_of(decoded(stream, wanted=wanted))
        assert set(wanted) <= set(found)
        assert set(found) <= set(range(first - LENGTH, first + 2 + LENGTH))
        assert found.items() <= whole.items()


def test_the_command_writes_any_part(stream: bytes, tmp_path: Path) -> None:
    (tmp_path / "s.dvc").write_bytes(stream)

    def video_of(*options: str) -> bytes:
        words = [str(tmp_path / "s.dvc"), str(tmp_path / "video.y4m"), "--quiet", *options]
        assert decoder.main(words) == 0
        head, frames = (tmp_path / "video.y4m").read_bytes().split(b"\n", 1)
        assert head.startswith(b"YUV4MPEG2")
        return frames

    whole = video_of()
    size = len(whole) // NUM_FRAMES
    rng = np.random.default_rng(1)
    for first, last in [(0, 1), (9, 11), (29, 30), *np.sort(rng.integers(0, NUM_FRAMES, (8, 2)))]:
        part = video_of("--frames", f"{first}:{last + 1}", "--jobs", str(1 + last % 2))
        assert part == whole[first * size : (last + 1) * size]


def test_key_frames_before_a_part_are_decoded_from_their_chain_on(stream: bytes) -> None:
    for first in range(4, NUM_FRAMES):
        tasks = tasks_of(stream, range(first, first + 1))
        assert len(tasks) == 1
        assert tasks[0].first_index <= first <= tasks[0].last_index
        assert tasks[0].before is not None


def changed(stream: bytes, place: int, **values: object) -> bytes:
    """Return a stream with another group of pictures in it."""
    reader = StreamReader(io.BytesIO(stream))
    records = list(reader)
    records[place] = replace(records[place], **values)  # type: ignore[arg-type]
    return written(reader.config, records, Form.BUFFERED)


def first_error(stream: bytes) -> tuple[int, str]:
    """Return how many groups are decoded, and what ends that."""
    reader = StreamReader(io.BytesIO(stream))
    number = 0
    try:
        for _ in stream_tasks(reader.config, reader):
            number += 1
    except BitstreamError as err:
        return number, str(err)
    return number, ""


@pytest.mark.parametrize(
    ("place", "predicted", "message"),
    [
        (0, True, "record 1 (group of pictures) at byte [0-9]+: a predicted key frame has no reference here"),
        (2, False, "group of pictures 2: key frame: key frame: "),
        (4, True, "group of pictures 4: key frame: no IDR picture since 13 frames"),
    ],
)
def test_streams_that_lie_about_prediction_are_refused(
    stream: bytes, place: int, predicted: bool, message: str
) -> None:
    number, found = first_error(changed(stream, place, predicted=predicted))
    assert number == place
    with pytest.raises(BitstreamError, match=message.replace("(", r"\(").replace(")", r"\)")):
        raise BitstreamError(found)


@pytest.mark.parametrize(("intra_period", "place", "told"), [(10, 11, 0), (9, 3, 10), (7, 3, 10), (6, 2, 7)])
def test_a_chain_longer_than_the_intra_period_is_refused(
    stream: bytes, intra_period: int, place: int, told: int
) -> None:
    reader = StreamReader(io.BytesIO(stream))
    config = replace(reader.config, key=replace(reader.config.key, intra_period=intra_period))
    message = f"group of pictures {place}: key frame: no IDR picture since {told} frames" if told else ""
    assert first_error(written(config, list(reader), Form.BUFFERED)) == (place, message)


@pytest.mark.parametrize("place", [1, 2])
def test_a_damaged_key_frame_ends_decoding(stream: bytes, groups: list[DecodedGroup], place: int) -> None:
    damaged = changed(stream, place, key=b"\xff" * 9)
    number, told = first_error(damaged)
    assert number == place
    assert told.startswith(f"group of pictures {place}: key frame: ")
    assert planes_of(decoded(damaged, wanted=range(28, 30))).items() <= planes_of(groups).items()


def test_groups_of_key_frames_alone() -> None:
    config = codec_config(VideoConfig(WIDTH, HEIGHT, 25, 1), "2d", gop=GopConfig(1), key={"intra_period": 4})
    stream = encoded(config, FRAMES[:10])
    found = decoded(stream)
    assert "".join("IP"[group.record.predicted] for group in found) == "IPPPIPPPIP"
    assert not any(group.wyner_ziv for group in found)
    whole = planes_of(found)
    for first in range(10):
        assert planes_of(decoded(stream, wanted=range(first, 10))).items() <= whole.items()
