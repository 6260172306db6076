"""Time stamps of streams: when frames are shown, in one stream and in the segments of a recording."""

import io
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from decoder.session import decode_stream
from dvc.config import CodecConfig, VideoConfig
from dvc.errors import BitstreamError
from dvc.stream import (
    MAX_DEVIATION_TICKS,
    Deviations,
    Form,
    GopRecord,
    RecordingReader,
    StreamReader,
    frame_times_s,
)
from dvc.video import Frame
from encoder.encoder_session import EncoderSession
from tests.clips import moving_texture
from tests.streams import written

VIDEO = VideoConfig(32, 24, 30, 1)


def test_times_are_whole_ticks_where_they_are_not_constant() -> None:
    """Deviations are counted from the tick next to the constant rate, so that a source's ticks come back."""
    assert frame_times_s(VIDEO, 4, 2, None) == [Fraction(4, 30), Fraction(5, 30)]
    assert frame_times_s(VIDEO, 4, 2, Deviations(1000, (0, -7))) == [Fraction(133, 1000), Fraction(160, 1000)]
    assert frame_times_s(VIDEO, 1, 1, Deviations(15, (0,))) == [Fraction(1, 15)]


def records(count: int) -> tuple[CodecConfig, list[GopRecord]]:
    session = EncoderSession(CodecConfig(VIDEO))
    frames = [Frame(frame.luma) for frame in moving_texture(count, 24, 32)]
    return session.config, [next(iter(one(session, frame))) for frame in frames]


def one(session: EncoderSession, frame: Frame) -> list[GopRecord]:
    return [session.encode(group).record for group in session.groups([frame])]


def with_times(
    config: CodecConfig, coded: list[GopRecord], late_ticks: list[int], clock: int = 1000
) -> bytes:
    """Write key frames that are later than at the constant rate."""
    deviations = [Deviations(clock, (late,)) if late else None for late in late_ticks]
    records = [replace(record, deviations=one) for record, one in zip(coded, deviations, strict=True)]
    return written(config, records, Form.PUNCTURED)


@pytest.mark.parametrize(("late_ticks", "number"), [([0, -34, 0], 1), ([0, 40, 0], 2), ([34, 0, 0], 1)])
def test_frames_must_follow_each_other(late_ticks: list[int], number: int) -> None:
    config, coded = records(3)
    reader = StreamReader(io.BytesIO(with_times(config, coded, late_ticks)))
    groups = []
    with pytest.raises(BitstreamError, match=f"group of pictures {number}: a time stamp is not later"):
        groups += decode_stream(config, reader)
    reader = StreamReader(io.BytesIO(with_times(config, coded, [0, -32, 5])))
    assert len(list(decode_stream(config, reader))) == 3


def test_segments_go_on_where_the_one_before_ended(tmp_path: Path) -> None:
    """Their time stamps are counted from their own beginning, those of the recording from its."""
    config, coded = records(2)
    for number, late_ticks in enumerate(([0, 50], [0, 0], [2, 2])):
        (tmp_path / f"{number}.dvc").write_bytes(with_times(config, coded, late_ticks))
    with RecordingReader(tmp_path) as reader:
        found = [record.deviations for record in reader]
        assert found == [None, *(Deviations(1000, (late,)) for late in (50, 50, 50, 52, 52))]
        reader.seek_gop(3)
        assert [record.deviations for record in reader] == [None, *[Deviations(1000, (2,))] * 2]


def test_segments_do_not_add_up_to_more_than_a_stream_holds(tmp_path: Path) -> None:
    config, coded = records(2)
    for number in range(2):
        (tmp_path / f"{number}.dvc").write_bytes(with_times(config, coded, [0, MAX_DEVIATION_TICKS], 1))
    with RecordingReader(tmp_path) as reader:
        found = [record.deviations for record in reader]
    assert found == [None, *[Deviations(1, (MAX_DEVIATION_TICKS,))] * 3]
