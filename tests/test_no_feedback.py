"""Streams without a feedback channel, from command to command."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from dvc.geometry.cameras import PixelFrame
from dvc.stream import Form, StreamReader, StreamWriter
from dvc.video import Frame
from tests.clips import moving_texture, write_clip
from tests.scenes_3d import render

SIZE = (104, 88)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write seven views of a static scene."""
    frames = [Frame(render(time, PixelFrame(*SIZE))[0]) for time in np.linspace(0.0, 1.0, 7)]
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.y4m", frames)


def encoded(clip: Path, stream: Path, *options: str) -> Path:
    """Encode the clip without feedback; return the stream."""
    arguments = [str(clip), str(stream), "--gop", "6", "--qp", "14", "--luma-only", "--quiet"]
    assert encoder.main([*arguments, "--no-feedback", *options]) == 0
    return stream


def decoded(stream: Path, folder: Path, *options: str) -> tuple[dict[str, Any], bytes]:
    """Decode a stream; return the report and the video."""
    video, report = folder / "video.y4m", folder / "report.json"
    assert decoder.main([str(stream), str(video), "--json", str(report), "--quiet", *options]) == 0
    return json.loads(report.read_text()), video.read_bytes()


@pytest.fixture(scope="module")
def stream(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Encode the clip once."""
    return encoded(clip, tmp_path_factory.mktemp("stream") / "stream.dvc")


def test_frames_are_as_they_are_predicted(clip: Path, stream: Path, tmp_path: Path) -> None:
    report, video = decoded(stream, tmp_path, "--reference", str(clip))
    assert report["stream_bytes"] == stream.stat().st_size
    assert sum(report["bits"].values()) == 8 * report["stream_bytes"]
    assert report["num_requests"] == report["bits"]["parity"] == report["bits"]["crc"] == 0
    rows = [row for row in report["per_frame"] if row["type"] == "wz"]
    assert rows
    for row in rows:
        assert row["psnr_y_db"] == pytest.approx(row["si_psnr_y_db"], abs=0.1)
    assert report["psnr_y_db"] > 25.0
    assert decoded(stream, tmp_path, "--jobs", "2")[1] == video
    arguments = [str(clip), str(tmp_path / "b.dvc"), "--gop", "6", "--qp", "14", "--luma-only", "--quiet"]
    assert encoder.main(arguments) == 0
    assert stream.stat().st_size < 0.5 * (tmp_path / "b.dvc").stat().st_size
    for num_frames in (1, 2):
        short = encoded(clip, tmp_path / "short.dvc", "--frames", str(num_frames))
        assert decoded(short, tmp_path)[0]["frames"] == num_frames


def test_a_frame_that_holds_anything_is_refused(
    stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with StreamReader(stream) as reader, (tmp_path / "more.dvc").open("wb") as file:
        assert reader.form is Form.NO_FEEDBACK
        with StreamWriter(file, reader.config, reader.form) as writer:
            for record in reader:
                assert not any(record.wyner_ziv)
                writer.write_gop(replace(record, wyner_ziv=(b"\0",) * len(record.wyner_ziv)))
    assert decoder.main([str(tmp_path / "more.dvc"), str(tmp_path / "v.y4m"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert ": group of pictures " in line
    assert "a Wyner-Ziv frame of a stream without feedback is not empty" in line


@pytest.mark.parametrize(
    "options",
    [
        ("--codec", "2d", "--gop", "3", "--qp", "14"),
        ("--codec", "3d-td", "--gop", "3", "--qp", "14"),
        ("--wz-q", "4"),
        ("--key-qp", "lossless"),
        ("--references", "all", "--noise-model", "frame"),
    ],
    ids=" ".join,
)
def test_every_codec_and_quality_serves(clip: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    stream = tmp_path / "stream.dvc"
    assert encoder.main([str(clip), str(stream), "--no-feedback", "--luma-only", "--quiet", *options]) == 0
    report, _ = decoded(stream, tmp_path, "--reference", str(clip))
    types = {row["type"] for row in report["per_frame"]}
    assert (report["frames"], types, report["num_requests"]) == (7, {"key", "wz"}, 0)
    assert report["psnr_y_db"] > 20.0


def test_chroma_has_the_quality_of_luma(tmp_path: Path) -> None:
    half = [frame.luma for frame in moving_texture(4, 16, 24)]
    lumas = [frame.luma for frame in moving_texture(2, 32, 48)]
    frames = [Frame(luma, (half[k], half[k + 2])) for k, luma in enumerate(lumas)]
    clip, sizes = write_clip(tmp_path / "clip.y4m", frames), []
    for options in ((), ("--no-feedback",)):
        stream = tmp_path / "stream.dvc"
        assert encoder.main([str(clip), str(stream), "--qp", "20", "--quiet", *options]) == 0
        with StreamReader(stream) as reader:
            sizes.append(sum(len(record.key) for record in reader))
    assert sizes[1] < sizes[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--no-feedback", "--coder", "turbo"], "--no-feedback excludes --coder turbo"),
        (["--key-frames", "intra", "--intra-period", "9"], "--intra-period excludes --key-frames intra"),
        (["--no-feedback", "--serve", "127.0.0.1:0"], "give either OUTPUT or --serve"),
        (["--bitrate", "300k"], "--bitrate requires --serve or --no-feedback"),
        (["--max-bits-per-frame", "300k"], "--max-bits-per-frame requires --serve or --no-feedback"),
        (["--no-feedback", "--bitrate", "300k", "--qp", "30"], "--bitrate excludes --qp"),
        (["--no-feedback", "--bitrate", "300k", "--wz-q", "3"], "--bitrate excludes --wz-q"),
        (["--no-feedback", "--bitrate", "300k", "--key-qp", "20"], "--bitrate excludes --key-qp"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    assert encoder.main([str(clip), str(tmp_path / "none.dvc"), "--quiet", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not (tmp_path / "none.dvc").exists()


def test_a_cut_stream_is_told(stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(stream), str(tmp_path / "v.y4m"), "--punctured", str(tmp_path / "p.dvc")]
    assert decoder.main([*files, "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "not one without feedback" in line
    data = stream.read_bytes()
    for size in (0, 10, len(data) // 3, len(data) - 1):
        (tmp_path / "cut.dvc").write_bytes(data[:size])
        assert decoder.main([str(tmp_path / "cut.dvc"), str(tmp_path / "v.y4m"), "--quiet"]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
        assert not (tmp_path / "v.y4m").exists()
