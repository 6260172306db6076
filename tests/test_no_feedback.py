"""Streams without a feedback channel, from command to command."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from dvc.multiview.cameras import PixelFrame
from dvc.stream import Form, StreamReader, StreamWriter
from dvc.video import Frame
from tests.clips import write_clip
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


def test_a_wide_margin_decodes_everything(clip: Path, tmp_path: Path) -> None:
    """The file is what is counted; frames are better than their prediction, in any number of processes."""
    stream = encoded(clip, tmp_path / "wide.dvc", "--rate-margin", "1000")
    report, video = decoded(stream, tmp_path, "--reference", str(clip))
    assert report["stream_bytes"] == stream.stat().st_size
    assert sum(report["bits"].values()) == 8 * report["stream_bytes"]
    assert report["num_failed_planes"] == report["num_requests"] == 0
    assert report["bits"]["parity"] > 0
    assert report["wz_psnr_y_db"] > report["si_psnr_y_db"]
    assert report["plane_bits"]["all"]["ratio"] > 1.0
    assert decoded(stream, tmp_path, "--jobs", "2")[1] == video


def _damaged(payload: bytes) -> bytes:
    """Change syndrome bits, if there are any."""
    if len(payload) < 40:
        return payload
    return payload[:-9] + bytes(byte ^ 0x5A for byte in payload[-9:-1]) + payload[-1:]


def test_planes_that_are_short_are_concealed(clip: Path, tmp_path: Path) -> None:
    """Half of the syndrome bits unlike what was coded: a video all the same, and a report that tells."""
    stream = encoded(clip, tmp_path / "good.dvc", "--rate-margin", "100")
    with StreamReader(stream) as reader, (tmp_path / "short.dvc").open("wb") as file:
        assert reader.form is Form.NO_FEEDBACK
        with StreamWriter(file, reader.config, reader.form) as writer:
            for record in reader:
                payloads = [_damaged(data) for data in record.wyner_ziv]
                writer.write_gop(replace(record, wyner_ziv=tuple(payloads)))
    report, _ = decoded(tmp_path / "short.dvc", tmp_path, "--reference", str(clip))
    assert report["frames"] == 7
    assert report["num_failed_planes"] > 0
    assert any(row.get("num_failed_planes") for row in report["per_frame"])
    assert report["psnr_y_db"] > 25.0


def test_what_is_short_serves_all_the_same(clip: Path, tmp_path: Path) -> None:
    """Frames of which a syndrome was too short are hardly worse than their prediction."""
    stream = encoded(clip, tmp_path / "short.dvc", "--rate-margin", "0", "--qp", "18")
    report, _ = decoded(stream, tmp_path, "--reference", str(clip))
    rows = [row for row in report["per_frame"] if row.get("num_failed_planes")]
    assert rows
    assert min(row["psnr_y_db"] - row["si_psnr_y_db"] for row in rows) > -0.05


def test_streams_are_small(clip: Path, tmp_path: Path) -> None:
    """Below those that hold all planes, with a large margin, too; less margin is less of a file."""
    sizes = [
        encoded(clip, tmp_path / "s.dvc", "--rate-margin", margin).stat().st_size for margin in ("0", "200")
    ]
    arguments = [str(clip), str(tmp_path / "b.dvc"), "--gop", "6", "--qp", "14", "--luma-only", "--quiet"]
    assert encoder.main(arguments) == 0
    assert sizes[0] < sizes[1] < (tmp_path / "b.dvc").stat().st_size


@pytest.mark.parametrize("num_frames", [1, 2])
def test_short_clips(clip: Path, tmp_path: Path, num_frames: int) -> None:
    """One frame is a key frame; two are two."""
    stream = encoded(clip, tmp_path / "one.dvc", "--frames", str(num_frames))
    assert decoded(stream, tmp_path)[0]["frames"] == num_frames


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--no-feedback", "--codec", "2d"], "--no-feedback is for --qp and codecs whose encoder tracks"),
        (["--no-feedback", "--wz-q", "4"], "--no-feedback is for --qp and codecs whose encoder tracks"),
        (["--rate-margin", "10"], "--rate-margin is for --no-feedback"),
        (["--no-feedback", "--coder", "turbo"], "--long-delay and --coder are not for --no-feedback"),
        (["--no-feedback", "--long-delay"], "--long-delay and --coder are not for --no-feedback"),
        (["--key-frames", "intra", "--intra-period", "9"], "--intra-period is for --key-frames predicted"),
        (["--no-feedback", "--serve", "127.0.0.1:0"], "give either OUTPUT or --serve"),
        (["--bitrate", "300k"], "--bitrate and --max-bits-per-frame are for --serve and --no-feedback"),
        (["--max-bits-per-frame", "300k"], "--bitrate and --max-bits-per-frame are for --serve"),
        (["--no-feedback", "--bitrate", "300k", "--qp", "30"], "give it or --qp"),
        (["--bitrate", "300k", "--wz-q", "3"], "give it or --wz-q"),
        (["--no-feedback", "--bitrate", "300k", "--key-qp", "20"], "no --key-qp"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    """In one line, and nothing is written."""
    assert encoder.main([str(clip), str(tmp_path / "none.dvc"), "--quiet", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not (tmp_path / "none.dvc").exists()


def test_there_is_nothing_to_puncture(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The stream holds no more than what is used."""
    stream = encoded(clip, tmp_path / "one.dvc", "--frames", "2")
    files = [str(stream), str(tmp_path / "v.y4m"), "--punctured", str(tmp_path / "p.dvc")]
    assert decoder.main([*files, "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "not for no-feedback streams" in line


def test_a_cut_stream_is_told(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Wherever it ends; frames before are kept if they are wanted."""
    data = encoded(clip, tmp_path / "whole.dvc").read_bytes()
    for size in (0, 10, len(data) // 3, len(data) - 1):
        (tmp_path / "cut.dvc").write_bytes(data[:size])
        assert decoder.main([str(tmp_path / "cut.dvc"), str(tmp_path / "v.y4m"), "--quiet"]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
        assert not (tmp_path / "v.y4m").exists()
