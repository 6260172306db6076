"""Decoding of whole streams in memory, and the report of a run."""

import io
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from decoder.group_tasks import DecodedGroup
from decoder.session import decode_stream
from dvc.config import (
    CodecConfig,
    DiscoverMatrix,
    GopConfig,
    SideInformationConfig,
    TracksConfig,
    VideoConfig,
    codec_config,
)
from dvc.errors import BitstreamError
from dvc.metrics import psnr_db
from dvc.stream import Form, StreamReader
from dvc.tracks import PointTracks, encode_tracks
from dvc.video import Frame
from encoder.encoder_session import EncoderSession
from tests.clips import moving_texture
from tests.streams import config_of, decoded, encoded, written

CONFIG = codec_config(VideoConfig(24, 16, 25, 1), "2d", DiscoverMatrix(2), gop={"length": 3}, key={"qp": 30})


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Return an original of three groups: one frame, three frames, two frames."""
    return moving_texture(6, 16, 24)


@pytest.fixture(scope="module")
def stream(frames: list[Frame]) -> bytes:
    return encoded(CONFIG, frames)


@pytest.fixture(scope="module")
def groups(stream: bytes) -> list[DecodedGroup]:
    return decoded(stream)


def punctured_stream(groups: list[DecodedGroup], config: CodecConfig) -> bytes:
    return written(config, [group.record for group in groups], Form.PUNCTURED)


def frames_of(groups: list[DecodedGroup]) -> list[Frame]:
    return [frame for group in groups for frame in group.frames]


def test_groups_come_in_display_order(groups: list[DecodedGroup], frames: list[Frame]) -> None:
    assert [group.first_index for group in groups] == [0, 1, 4]
    assert [wz.index for group in groups for wz in group.wyner_ziv] == [1, 2, 4]
    found = frames_of(groups)
    assert len(found) == len(frames)
    quality = [psnr_db(a.luma, b.luma) for a, b in zip(found, frames, strict=True)]
    assert min(quality) > 26
    assert sorted(quality)[1] > 33


def test_groups_before_damage_are_decoded(stream: bytes, groups: list[DecodedGroup]) -> None:
    place = stream.rindex(groups[-1].record.key)
    reader = StreamReader(io.BytesIO(stream[:place] + bytes([stream[place] ^ 1]) + stream[place + 1 :]))
    found: list[int] = []
    with pytest.raises(BitstreamError, match="record 3"):
        found.extend(group.first_index for group in decode_stream(reader.config, reader))
    assert found == [group.first_index for group in groups[:2]]


@pytest.mark.parametrize(("jobs", "length"), [(1, 0), (2, 0), (1, 1), (1, 200)])
def test_nothing_after_damage_is_decoded(stream: bytes, jobs: int, length: int) -> None:
    config, records = config_of(stream), list(StreamReader(io.BytesIO(stream)))
    bad = replace(records[1], wyner_ziv=(bytes(length), records[1].wyner_ziv[1]))
    sent = [*records[:2], bad, *records[1:], *records[1:]]
    reader = StreamReader(io.BytesIO(written(config, sent, Form.BUFFERED)))
    found: list[int] = []
    with pytest.raises(BitstreamError, match="group of pictures 2: "):
        found.extend(group.first_index for group in decode_stream(config, reader, jobs))
    assert found == [0, 1]


def test_bits_of_a_punctured_payload_may_be_anything(stream: bytes, groups: list[DecodedGroup]) -> None:
    config, rng = config_of(stream), np.random.default_rng(1)
    for _ in range(6):
        record = groups[1].record
        payloads = tuple(rng.bytes(max(len(payload), 40)) for payload in record.wyner_ziv)
        records = [groups[0].record, replace(record, wyner_ziv=payloads)]
        with suppress(BitstreamError):
            assert len(decoded(written(config, records, Form.PUNCTURED))) == 2


def test_punctured_group_with_another_digest_is_refused(stream: bytes, groups: list[DecodedGroup]) -> None:
    config, record = config_of(stream), groups[1].record
    assert record.digest is not None
    other = replace(groups[1], record=replace(record, digest=record.digest ^ 1))
    with pytest.raises(BitstreamError, match=r"group of pictures 1: .*other predictions.*digest"):
        decoded(punctured_stream([groups[0], other], config))


TRACKED = replace(
    CONFIG,
    codec="3d-te",
    gop=GopConfig(3, "hierarchical"),
    side_information=SideInformationConfig(track_corrections=False, fallback="block-motion"),
    tracks=TracksConfig("encoder", subpixel_bits=0),
)
STILL = PointTracks(np.tile(np.array([[[4.0, 4.0]], [[16.0, 8.0]]]), (1, 4, 1)))
"""Tracks through a group of two Wyner-Ziv frames."""


def with_tracks(config: CodecConfig, tracks: bytes, position: int) -> bytes:
    """Return a stream of three groups, of which one carries these tracks."""
    session = EncoderSession(replace(config, codec="2d", tracks=CONFIG.tracks))
    records = [
        replace(session.encode(group).record, tracks=tracks if number == position else b"")
        for number, group in enumerate(session.groups(moving_texture(6, 16, 24)))
    ]
    return written(replace(config, key=session.config.key), records, Form.BUFFERED)


@pytest.mark.parametrize(
    ("config", "tracks", "position", "message"),
    [
        (CONFIG, b"x", 1, "group of pictures 1: tracks in a stream with a configuration without tracks"),
        (CONFIG, b"x", 0, "group of pictures 0: tracks, but no Wyner-Ziv frames"),
        (TRACKED, b"\xff" * 9, 1, "group of pictures 1: "),
        (TRACKED, b"\x00", 1, "group of pictures 1: "),
    ],
)
def test_tracks_that_cannot_be_are_refused(
    config: CodecConfig, tracks: bytes, position: int, message: str
) -> None:
    with pytest.raises(BitstreamError, match=message):
        decoded(with_tracks(config, tracks, position))


def test_tracks_are_read_and_kept() -> None:
    payload = encode_tracks(STILL, TRACKED)
    groups = decoded(with_tracks(TRACKED, payload, 1))
    assert groups[1].record.tracks == payload
    assert all(wz.method == "mci" and wz.reason for wz in groups[1].wyner_ziv)
    assert frames_of(groups)[0].luma.shape == (16, 24)
