"""Streams that declare more than they hold: refused before anything is spent on them."""

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import decoder.__main__
from decoder.session import decode_stream
from dvc.config import Qp, VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.keyframes import KeyFrameDecoder, KeyFrameEncoder
from dvc.limits import MAX_FRAMES, Limits
from dvc.stream import GopRecord, StreamReader, StreamWriter
from dvc.video import Frame
from dvc.wynerziv.quantizer import quantization_of_step


def bomb(width: int, height: int, gop: int, num_gops: int) -> bytes:
    """Return a stream of grey key frames, and of Wyner-Ziv frames between them that have no plane."""
    keys = KeyFrameEncoder(width, height, 51, luma_only=True)
    key = keys.encode(Frame(np.full((height, width), 128, np.uint8))).data
    video = VideoConfig(width, height, 25, 1, luma_only=True)
    key_config = {"parameter_sets": keys.parameter_sets}
    config = codec_config(video, "2d", Qp(51), gop={"length": gop}, key=key_config)
    empty = quantization_of_step(0, (0,) * 16).header
    file = io.BytesIO()
    with StreamWriter(file, config, "buffered") as writer:
        writer.write_gop(GopRecord(1, key))
        for _ in range(num_gops):
            writer.write_gop(GopRecord(gop, key, False, b"", (empty,) * (gop - 1)))
    return file.getvalue()


@pytest.mark.parametrize(
    ("size", "gop", "num_gops"), [((176, 144), 110, 1), ((720, 576), 256, 6), ((4096, 4096), 30, 1)]
)
def test_frames_without_planes_are_refused_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    size: tuple[int, int],
    gop: int,
    num_gops: int,
) -> None:
    """What declares thousands of times its size is refused at once, and nothing is written."""
    (tmp_path / "bomb.dvc").write_bytes(bomb(*size, gop, num_gops))
    monkeypatch.setattr(KeyFrameDecoder, "decode", None)  # so that not even one key frame can be decoded
    assert decoder.__main__.main([str(tmp_path / "bomb.dvc"), str(tmp_path / "out.y4m"), "--quiet"]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"{gop * num_gops + 1} frames of {size[0]}x{size[1]}" in line
    assert "--max-frames" in line
    assert os.listdir(tmp_path) == ["bomb.dvc"]


def test_a_small_stream_is_decoded_in_little_memory(tmp_path: Path) -> None:
    """The most that 600 bytes may hold is seven frames of 176x144, and takes no more than 300 MiB."""
    data = bomb(176, 144, 25, 1)
    assert len(data) < 600
    video = VideoConfig(176, 144, 25, 1)
    Limits().check_frames(7, 600, video)
    with pytest.raises(BitstreamError, match="more than the 7 that are allowed"):
        Limits().check_frames(8, 600, video)
    (tmp_path / "small.dvc").write_bytes(data)
    program = (
        "import resource, sys, decoder.__main__\n"
        "assert decoder.__main__.main(sys.argv[1:]) == 0\n"
        "from decoder.processes import stop_idle_processes\n"
        "stop_idle_processes()\n"
        "from dvc.memory import peak_resident_bytes\n"
        "own = peak_resident_bytes() // 1024\n"  # that of `getrusage` is also of the parent
        "print(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss))\n"
    )
    arguments = [str(tmp_path / "small.dvc"), str(tmp_path / "out.y4m")]
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments, "--max-frames", "26"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(done.stdout) < 300 * 1024


def test_small_frames_need_hardly_any_bytes() -> None:
    """Flat pictures of 48x32 may be 65 in a stream of any size."""
    video = VideoConfig(48, 32, 25, 1)
    Limits().check_frames(65, 60, video)
    with pytest.raises(BitstreamError, match="more than the 65 that are"):
        Limits().check_frames(66, 60, video)


def test_large_frames_need_bytes() -> None:
    """A Wyner-Ziv frame of 1280x720 pixels would take seconds, and more than 300 MiB: it needs 1.3 kB."""
    video = VideoConfig(1280, 720, 25, 1)
    Limits().check_frames(1, 600, video)
    Limits().check_frames(2, 1310, video)
    with pytest.raises(BitstreamError, match="more than the 1 that are"):
        Limits().check_frames(2, 1300, video)


def test_more_is_allowed_on_request() -> None:
    data = bomb(352, 288, 250, 1)
    with (
        StreamReader(io.BytesIO(data)) as reader,
        pytest.raises(BitstreamError, match="251 frames of 352x288"),
    ):
        decode_stream(reader.config, reader)
    with StreamReader(io.BytesIO(data)) as reader:
        groups = decode_stream(reader.config, reader, limits=Limits(max_frames=251))
        assert next(groups).first_index == 0
        groups.close()
    with StreamReader(io.BytesIO(data)) as reader, pytest.raises(BitstreamError, match="--max-memory"):
        decode_stream(reader.config, reader, limits=Limits(251, max_memory_mib=100))


class Pipe(io.BytesIO):
    """A stream that can only be read."""

    def seekable(self) -> bool:
        """Say no."""
        return False


def test_frames_from_a_pipe_are_counted_as_they_come() -> None:
    """Where nothing is known of the end, decoding stops at the group that is too much."""
    data = bomb(352, 288, 250, 1)
    found: list[int] = []
    with StreamReader(Pipe(data)) as reader, pytest.raises(BitstreamError, match="251 frames of 352"):
        found.extend(group.first_index for group in decode_stream(reader.config, reader))
    assert found == [0]


def test_defaults_serve_what_is_used() -> None:
    """Hours of small pictures, large pictures, and still ones at the coarsest quality."""
    limits = Limits()
    qcif, cif = VideoConfig(176, 144, 15, 1), VideoConfig(352, 288, 30, 1)
    hd, uhd = VideoConfig(1920, 1080, 60, 1), VideoConfig(3840, 2160, 30, 1)
    limits.check_frames(65, 1300, qcif)  # a photograph as a video, at QP 49
    limits.check_frames(8 * 108_000, 8 * 3600 * 12_500, cif)  # eight hours at 100 kbit/s
    limits.check_frames(216_000, 3600 * 25_000, hd)
    for video in (cif, hd, uhd):
        limits.check_memory(video, 48, 1)
    limits.check_memory(hd, 64 + 96, 2)
    with pytest.raises(BitstreamError, match=f"{MAX_FRAMES} that are allowed"):
        limits.check_frames(MAX_FRAMES + 1, 2**40, cif)
