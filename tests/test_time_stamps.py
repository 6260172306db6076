"""Frames keep their times from the source to the decoded file: files, segments, parts, live runs."""

import json
from fractions import Fraction
from pathlib import Path

import pytest

import decoder.__main__
import encoder.__main__
from dvc.stream import StreamReader, gop_bits
from dvc.video import create_video, open_video
from tests.clips import moving_texture
from tests.serving import frames_shown

STEPS_MS = (17, 33, 34, 500, 40, 40, 12, 33, 1000, 40)
TIMES_MS = [0, *(sum((STEPS_MS * 3)[: number + 1]) for number in range(25))]
CODING = ("--codec", "2d", "--wz-q", "1", "--gop", "4", "--quiet")


@pytest.fixture(scope="module")
def phone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a clip as a phone makes it, with a frame whenever there is light enough."""
    path = tmp_path_factory.mktemp("phone") / "phone.mkv"
    with create_video(path, (48, 32), 30) as writer:
        for time_ms, frame in zip(TIMES_MS, moving_texture(len(TIMES_MS), 32, 48), strict=True):
            writer.write(frame, Fraction(time_ms, 1000))
    return path


@pytest.fixture(scope="module")
def stream(phone: Path) -> Path:
    path = phone.with_name("phone.dvc")
    assert encoder.__main__.main([str(phone), str(path), *CODING]) == 0
    return path


def decode(*arguments: object) -> None:
    assert decoder.__main__.main([*map(str, arguments), "--quiet"]) == 0


def times_ms(path: Path) -> list[Fraction]:
    return [1000 * time_s for _, time_s in frames_shown(path)]


def test_times_come_through(tmp_path: Path, phone: Path, stream: Path) -> None:
    """Of the buffered and the punctured stream, of predictions too; as near as the format of the file is."""
    assert times_ms(phone) == TIMES_MS
    videos = tmp_path / "out.mkv", tmp_path / "predicted.mkv", tmp_path / "small.mp4"
    punctured = tmp_path / "small.dvc"
    decode(stream, videos[0], "--side-information-video", videos[1], "--punctured", punctured)
    decode(punctured, videos[2])
    assert times_ms(videos[0]) == times_ms(videos[1]) == TIMES_MS
    assert times_ms(videos[2]) == pytest.approx(TIMES_MS, abs=0.1)
    decode(stream, tmp_path / "part.mkv", "--frames", "6:15")  # counted from its beginning
    assert times_ms(tmp_path / "part.mkv") == [time_ms - TIMES_MS[6] for time_ms in TIMES_MS[6:15]]


def test_times_are_reported_and_cost_a_byte_or_two_a_frame(tmp_path: Path, stream: Path, phone: Path) -> None:
    """The rate is that of the time that the video takes; at a constant rate frames have no times."""
    decode(stream, tmp_path / "out.mkv", "--json", tmp_path / "r.json")
    report = json.loads((tmp_path / "r.json").read_text())
    assert [1000 * frame["time_s"] for frame in report["per_frame"]] == pytest.approx(TIMES_MS)
    assert report["duration_s"] == pytest.approx(TIMES_MS[-1] / 1000 + 1 / 30)
    assert report["rate_kbps"] == pytest.approx(8e-3 * report["stream_bytes"] / report["duration_s"])
    constant = tmp_path / "constant.dvc"
    assert encoder.__main__.main([str(phone), str(constant), "--frame-rate", "30", *CODING]) == 0
    decode(constant, tmp_path / "constant.mkv", "--json", tmp_path / "c.json")
    report = json.loads((tmp_path / "c.json").read_text())
    assert report["duration_s"] == pytest.approx(len(TIMES_MS) / 30)
    assert not any("time_s" in frame for frame in report["per_frame"])
    with StreamReader(stream) as reader, StreamReader(constant) as other:
        records, without = list(reader), list(other)
    assert records[0].deviations is None
    assert all(record.deviations is not None for record in records[2:])
    assert not any(record.deviations for record in without)
    cost = sum(gop_bits(record).header for record in records) - sum(gop_bits(r).header for r in without)
    assert cost <= 8 * (2 * len(TIMES_MS) + 3 * len(records))
    assert cost == 8 * (stream.stat().st_size - constant.stat().st_size)


def test_segments_of_a_recording_keep_the_times_between_them(tmp_path: Path, phone: Path) -> None:
    options = (*CODING, "--segment", "0.2")
    assert encoder.__main__.main([str(phone), str(tmp_path / "day.dvc"), *options]) == 0
    assert len(list(tmp_path.iterdir())) > 3
    decode(tmp_path / "day-0001.dvc", tmp_path / "one.mkv")
    decode(tmp_path, tmp_path / "all.mkv")
    assert times_ms(tmp_path / "one.mkv") == [time_ms - TIMES_MS[6] for time_ms in TIMES_MS[6:12]]
    assert times_ms(tmp_path / "all.mkv") == TIMES_MS


def test_y4m_cannot_hold_times(tmp_path: Path, stream: Path, caplog: pytest.LogCaptureFixture) -> None:
    decode(stream, tmp_path / "out.y4m")
    assert [record.getMessage() for record in caplog.records] == [
        "y4m holds no time stamps: frames with times of their own are at the constant rate"
    ]
    with open_video(tmp_path / "out.y4m") as reader:
        assert len(list(reader)) == len(TIMES_MS)
