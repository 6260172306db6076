"""Both programs as one call each: frames in, a stream, pictures with what is known of them out."""

import json
from pathlib import Path

import numpy as np
import pytest

import decoder
import decoder.__main__ as decoder_command
import encoder
import encoder.__main__ as encoder_command
from dvc.config import NoFeedback, Qp, VideoConfig, codec_config
from dvc.errors import BitstreamError, VideoError
from dvc.geometry.cameras import PixelFrame
from dvc.video import Frame, open_video
from tests.clips import same_frame, write_clip
from tests.scenes_3d import render

SIZE = (176, 144)
VIDEO = VideoConfig(*SIZE, 25, 1, luma_only=True)
CONFIG = codec_config(VIDEO, quality=Qp(30))


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [Frame(render(time, PixelFrame(*SIZE))[0]) for time in np.linspace(0.0, 1.0, 5)]


def test_calls_do_what_commands_do(frames: list[Frame], tmp_path: Path) -> None:
    clip, command, call = (tmp_path / name for name in ("clip.y4m", "command.dvc", "call.dvc"))
    write_clip(clip, frames)
    assert encoder_command.main([str(clip), str(command), "--qp", "30", "--luma-only", "--quiet"]) == 0
    statistics = encoder.encode(iter(frames), CONFIG, call)
    assert call.read_bytes() == command.read_bytes()
    assert (statistics.num_frames, statistics.stream_bytes) == (5, call.stat().st_size)
    video, said = tmp_path / "decoded.y4m", tmp_path / "said.json"
    options = ["--reference", str(clip), "--json", str(said), "--quiet"]
    assert decoder_command.main([str(call), str(video), *options]) == 0
    told = json.loads(said.read_text())
    with open_video(str(clip)) as reference, open_video(str(video)) as written:
        pictures = list(decoder.decode(call, reference=reference))
        for picture, frame in zip(pictures, written, strict=True):
            assert same_frame(picture.frame, frame)
    assert [picture.time_s * 25 for picture in pictures] == list(range(5))
    for picture, row in zip(pictures, told["per_frame"], strict=True):
        for name in ("index", "type", "psnr_y_db"):
            assert picture.report[name] == row[name]
        assert picture.report["bits"]["parity"] == row["bits"]["parity"]
        assert (picture.predicted is None) == (picture.report["type"] == "key")


def test_depth_is_that_of_the_scene(frames: list[Frame], tmp_path: Path) -> None:
    config = codec_config(VIDEO, quality=Qp(18))
    encoder.encode(frames, config, tmp_path / "stream.dvc")
    pictures = list(decoder.decode(tmp_path / "stream.dvc"))
    assert pictures[0].inverse_depth is None
    of_scene = [number for number, picture in enumerate(pictures) if picture.inverse_depth is not None]
    assert 2 in of_scene
    found = pictures[2].inverse_depth
    assert found is not None
    true = render(0.5, PixelFrame(*SIZE))[1]
    assert found.shape == true.shape
    assert np.corrcoef(found.ravel().astype(float), true.ravel())[0, 1] > 0.9


def test_a_stream_without_feedback(frames: list[Frame], tmp_path: Path) -> None:
    delivery, path = NoFeedback(), tmp_path / "stream.dvc"
    encoder.encode(frames, codec_config(VIDEO, quality=Qp(30)), path, delivery)
    assert len(list(decoder.decode(path))) == len(frames)


def test_wrong_input(frames: list[Frame], tmp_path: Path) -> None:
    path = tmp_path / "stream.dvc"
    with pytest.raises(VideoError, match="no frames"):
        encoder.encode([], CONFIG, path)
    with pytest.raises(VideoError, match="176x144"):
        encoder.encode([frames[0], Frame(frames[1].luma[:72])], CONFIG, path)
    assert list(tmp_path.iterdir()) == []
    path.write_bytes(b"no stream")
    with pytest.raises(BitstreamError):
        list(decoder.decode(path))
