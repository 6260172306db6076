"""Groups of pictures, and what the encoder writes and counts."""

import io
import time
from collections.abc import Iterator, Sequence
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import DiscoverMatrix, Quality, VideoConfig, codec_config
from dvc.keyframes import KeyFrameDecoder
from dvc.stream import Form, StreamReader
from dvc.video import Frame, VideoInfo
from encoder import encoder_options as options
from encoder.__main__ import new_session
from encoder._kernels import QUARTER_HALF_BLOCK_PX
from encoder.encoder_report import (
    LARGE_SAMPLES,
    SMALL_SAMPLES,
    TIMED_PARTS,
    TrackingWork,
    block_comparison,
    memory_report,
)
from encoder.encoder_session import EncoderSession
from encoder.groups import FixedGroups, Group
from tests.clips import moving_texture, same_frames

FRAMES = moving_texture(8, 8, 12)


@given(st.integers(0, 8), st.integers(1, 9))
def test_groups_cover_the_sequence(num_frames: int, length: int) -> None:
    sequence = FRAMES[:num_frames]
    found = list(FixedGroups(length).groups(sequence))
    flat = [frame for group in found for frame in (*group.wyner_ziv, group.key)]
    assert len(flat) == num_frames
    assert all(a is b for a, b in zip(flat, sequence, strict=True))
    sizes = [len(group.wyner_ziv) + 1 for group in found]
    assert sizes[:1] == [1] * (num_frames > 0)
    assert all(size == length for size in sizes[1:-1])
    assert all(size <= length for size in sizes[1:])


def session_of(**video: bool) -> EncoderSession:
    return EncoderSession(
        codec_config(VideoConfig(12, 8, 25, 1, **video), "2d", DiscoverMatrix(1), key={"lossless": True})
    )


def test_stream_describes_itself() -> None:
    session, file = session_of(), io.BytesIO()
    finished: list[int] = []
    session.write(FRAMES[:4], file, finished.append)
    assert finished == [1, 2, 1]
    reader = StreamReader(io.BytesIO(file.getvalue()))
    assert reader.form == Form.BUFFERED
    assert reader.config == session.config
    decoder = KeyFrameDecoder(12, 8, luma_only=False, parameter_sets=reader.config.key.parameter_sets)
    keys = [decoder.decode(record.key) for record in reader]
    for key, original in zip(keys, (FRAMES[0], FRAMES[2], FRAMES[3]), strict=True):
        assert (key.luma == original.luma).all()


def predicted_keys(session: EncoderSession, groups: Sequence[Group]) -> str:
    """Spell which key frames are IDR pictures (I), and which are predicted (P)."""
    return "".join("IP"[session.encode(group).record.predicted] for group in groups)


def chained_session(intra_period: int) -> EncoderSession:
    return EncoderSession(codec_config(VideoConfig(12, 8, 25, 1), "2d", key={"intra_period": intra_period}))


@pytest.mark.parametrize(
    ("intra_period", "lengths", "expected"),
    [
        (0, (1, 2, 2, 2), "IIII"),
        (1, (1, 1, 1), "III"),
        (2, (1, 1, 1, 1, 1), "IPIPI"),
        (2, (1, 2, 2, 1), "IIIP"),
        (5, (1, 2, 2, 2, 2, 2), "IPPIPP"),
        (5, (1, 3, 2, 1, 1), "IPIPP"),
        (96, (1, 2, 2, 2, 2), "IPPPP"),
        (4, (3, 3, 3), "IPI"),
    ],
)
def test_idr_pictures_come_within_the_intra_period(
    intra_period: int, lengths: Sequence[int], expected: str
) -> None:
    """Counted in frames from one of them; key frames that lie too far from it begin another chain."""
    found = [Group(tuple(FRAMES[: length - 1]), FRAMES[length]) for length in lengths]
    assert predicted_keys(chained_session(intra_period), found) == expected


def test_idr_pictures_come_at_cuts() -> None:
    session = chained_session(96)
    usual, cut = Group(tuple(FRAMES[:1]), FRAMES[1]), Group((), FRAMES[5], begins_scene=True)
    assert predicted_keys(session, [usual, usual, cut, usual]) == "IPIP"


@pytest.mark.parametrize(("codec", "quality"), [("2d", None), ("3d-te", DiscoverMatrix(4))])
def test_codecs_without_predicted_key_frames_write_intra_pictures(
    codec: str, quality: Quality | None
) -> None:
    config = codec_config(VideoConfig(12, 8, 25, 1), codec, quality, gop={"length": 2})
    session = EncoderSession(config)
    assert set(predicted_keys(session, list(session.groups(FRAMES)))) == {"I"}


def test_statistics_count_what_was_written() -> None:
    session, file = session_of(luma_only=True), io.BytesIO()
    session.write(FRAMES[:5], file, lambda _: None)
    counted = session.statistics
    assert (counted.num_frames, counted.num_key_frames, counted.num_wyner_ziv_frames) == (5, 3, 2)
    assert counted.stream_bytes == len(file.getvalue())
    records = list(StreamReader(io.BytesIO(file.getvalue())))
    assert counted.key_bits == 8 * sum(len(record.key) for record in records)


def test_work_without_a_decoder_is_counted() -> None:
    """Blocks that are compared with their prediction, one in four; no frame is transformed."""
    frames = moving_texture(5, 48, 64)
    arguments = options.parser().parse_args(["in", "out.dvc", "--no-feedback", "--qp", "20", "--gop", "2"])
    session = new_session(arguments, VideoInfo(64, 48, Fraction(25)))
    session.write(frames, io.BytesIO(), lambda _: None)
    counted, blocks = session.statistics, 12
    assert (counted.num_frames, counted.num_transformed) == (5, 0)
    work = counted.tracking
    assert work.num_interpolated == 2 * blocks
    assert 0 < work.num_near <= blocks * work.num_corners
    found = counted.operations_per_pixel(session.config)
    assert found["interpolation"]["adds"] > 0.0
    assert found["transform"]["adds"] == found["quantiser and planes"]["adds"] == 0.0


def test_memory_is_the_encoder_s_own() -> None:
    """What was held before, and what compiled code took, is no part of it; nothing is below zero."""
    found = memory_report(1000)
    assert found["own_bytes"] == found["peak_bytes"] - found["loaded_bytes"] - 1000
    assert memory_report(found["peak_bytes"] + 1)["own_bytes"] == 0


def test_operations_are_those_of_the_frames() -> None:
    session = session_of(luma_only=True)
    session.write(FRAMES[:5], io.BytesIO(), lambda _: None)
    counted, share = session.statistics, 2 / 5
    found = counted.operations_per_pixel(session.config)
    places = 6  # blocks of an 8 x 12 frame
    assert counted.num_transformed == counted.num_wyner_ziv_frames == 2
    assert 0 < counted.num_coded_bands <= counted.num_planes
    assert found["transform"]["adds"] == pytest.approx(5.0 * share)
    banded = counted.num_coded_bands * places / (5 * 96)
    assert found["quantiser and planes"]["multiplies"] == pytest.approx(banded)
    assert found["block matching"] == found["interpolation"] == dict.fromkeys(found["transform"], 0.0)
    counted.tracking = TrackingWork(num_blocks=5, num_samples=3 * LARGE_SAMPLES + 2 * SMALL_SAMPLES)
    both = block_comparison().times(3) + block_comparison(QUARTER_HALF_BLOCK_PX).times(2)
    found = counted.operations_per_pixel(session.config)
    assert found["block matching"]["adds"] == pytest.approx(both.adds / (5 * 96))


def test_times_are_parts_of_coding_which_neither_reads_nor_loads() -> None:
    """All parts fit into the time of coding; frames that take long to come make it no longer."""

    def slow(frames: Sequence[Frame]) -> Iterator[Frame]:
        for frame in frames:
            until = time.thread_time() + 0.05
            while time.thread_time() < until:
                pass
            yield frame

    session_of(luma_only=True).write(FRAMES[:5], io.BytesIO(), lambda _: None)  # code is loaded
    session = session_of(luma_only=True)
    started = time.thread_time()
    session.write(slow(FRAMES[:5]), io.BytesIO(), lambda _: None)
    total, counted = time.thread_time() - started, session.statistics
    assert counted.key_cpu_s > 0.0
    report = counted.to_dict()
    assert 0.0 < report["wyner_ziv_cpu_s"] == counted.transform_cpu_s + counted.parity_cpu_s
    assert report["other_cpu_s"] >= 0.0
    assert counted.reading_cpu_s >= 0.25
    assert counted.coding_cpu_s + counted.reading_cpu_s == pytest.approx(total, abs=0.02)
    assert sum(getattr(counted, name) for name in TIMED_PARTS) <= counted.coding_cpu_s


def test_colour_costs_more_than_luma() -> None:
    """Chroma changes nothing in Wyner-Ziv frames; a second run writes the same, and originals stay."""
    streams, records, sizes = [], [], []
    for luma_only in (True, False, False):
        session, file = session_of(luma_only=luma_only), io.BytesIO()
        session.write(FRAMES[:3], file, lambda _: None)
        streams.append(file.getvalue())
        records.append([record.wyner_ziv for record in StreamReader(io.BytesIO(file.getvalue()))])
        sizes.append(session.statistics.key_bits)
    assert records[0] == records[1]
    assert sizes[0] < sizes[1]
    assert streams[1] == streams[2]
    assert same_frames(FRAMES, moving_texture(8, 8, 12))
