"""Tests of video files that are written and read back."""

import os
import subprocess
import sys
import textwrap
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dvc.errors import VideoError
from dvc.metrics import psnr_db
from dvc.video import Frame, create_video, open_video
from tests.clips import same_frame, same_frames, write_clip

MakeFrames = Callable[..., list[Frame]]

SIZES = [(48, 32), (33, 25), (1, 1), (2, 3), (17, 1), (1, 40), (19, 16), (20, 23)]
RATES = [Fraction(25), Fraction(30000, 1001), Fraction(7, 3), Fraction(15)]

every_format = pytest.mark.parametrize("suffix", [".y4m", ".mkv", ".mp4"])


@pytest.mark.parametrize(("suffix", "grey"), [(".y4m", False), (".mkv", False), (".mkv", True)])
@pytest.mark.parametrize("size", SIZES[::2])
def test_lossless_formats_give_back_every_sample(
    tmp_path: Path, moving_frames: MakeFrames, suffix: str, grey: bool, size: tuple[int, int]
) -> None:
    frames = moving_frames(5, *size, grey=grey)
    for index, rate in enumerate(RATES):
        path = tmp_path / f"{index}{suffix}"
        write_clip(path, frames, rate, luma_only=grey)
        with open_video(path) as reader:
            info = reader.info
            assert (info.size, info.frame_rate, info.notices, info.full_range) == (size, rate, (), False)
            assert same_frames(reader, frames)


@pytest.mark.parametrize("size", [(426, 240), (480, 270), (854, 480), (4, 999), (353, 3), (641, 17)])
@every_format
def test_common_and_odd_sizes_beyond_cif_are_written(
    tmp_path: Path, moving_frames: MakeFrames, suffix: str, size: tuple[int, int]
) -> None:
    """FFV1 in FFmpeg takes only some numbers of slices for pictures wider than 352 or higher than 288."""
    for grey in (False, True):
        frames = moving_frames(1, *size, grey=grey)
        got = list(open_video(write_clip(tmp_path / f"{grey}{suffix}", frames, luma_only=grey)))
        assert len(got) == 1
        assert suffix == ".mp4" or same_frames(got, frames)


@pytest.mark.parametrize("size", [(48, 32), (33, 25), (1, 1)])
def test_mp4_is_near_to_the_source(tmp_path: Path, moving_frames: MakeFrames, size: tuple[int, int]) -> None:
    """H.264 keeps count, rate and the picture to within 38 dB; odd sides are padded by repetition."""
    frames = moving_frames(7, *size)
    write_clip(tmp_path / "a.mp4", frames, Fraction(30000, 1001))
    with open_video(tmp_path / "a.mp4") as reader:
        got = list(reader)
        assert (reader.info.frame_rate, reader.info.num_frames, len(got)) == (Fraction(30000, 1001), 7, 7)
    height, width = frames[0].luma.shape
    assert (got[0].height, got[0].width) == (height + height % 2, width + width % 2)
    assert min(psnr_db(a.luma[:height, :width].copy(), b.luma) for a, b in zip(got, frames, strict=True)) > 38


@every_format
def test_chroma_is_left_out_or_made_neutral(tmp_path: Path, moving_frames: MakeFrames, suffix: str) -> None:
    """Grey files come back grey, in MP4 with neutral chroma; grey frames in colour files get 128."""
    frames = moving_frames(3, 32, 16)
    got = list(open_video(write_clip(tmp_path / f"a{suffix}", frames, luma_only=True)))
    if suffix == ".mp4":
        assert all(np.all(plane == 128) for plane in got[1].chroma or (np.zeros(1),))
        return
    assert same_frames(got, [frame.without_chroma() for frame in frames])
    grey = moving_frames(2, 9, 7, grey=True)
    got = list(open_video(write_clip(tmp_path / f"b{suffix}", grey)))
    assert same_frames(got, [frame.with_chroma() for frame in grey])


@every_format
def test_full_range_mark_survives(tmp_path: Path, moving_frames: MakeFrames, suffix: str) -> None:
    """The reader learns that samples use 0 to 255, and keeps them."""
    frames = moving_frames(2, 16, 16)
    write_clip(tmp_path / f"a{suffix}", frames, full_range=True)
    with open_video(tmp_path / f"a{suffix}") as reader:
        assert reader.info.full_range
        assert reader.info.notices == ("full-range samples are kept as they are",)
        assert suffix == ".mp4" or same_frame(next(iter(reader)), frames[0])


@every_format
def test_two_runs_write_the_same_bytes(tmp_path: Path, moving_frames: MakeFrames, suffix: str) -> None:
    frames = moving_frames(3, 32, 16)
    for name in ("a", "b"):
        write_clip(tmp_path / f"{name}{suffix}", frames)
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@every_format
def test_file_appears_only_when_it_is_complete(
    tmp_path: Path, moving_frames: MakeFrames, suffix: str
) -> None:
    """The name exists after `close`; nothing is left after `abort` or an exception, which passes through."""
    path, (frame,) = tmp_path / f"a{suffix}", moving_frames(1, 32, 16)
    writer = create_video(path, (32, 16), 25)
    writer.write(frame)
    assert not path.exists()
    writer.abort()
    writer.abort()
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write(frame)
    writer = create_video(path, (32, 16), 25)
    with pytest.raises(KeyboardInterrupt), writer:  # noqa: PT012
        writer.write(frame)
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == []


def test_wrong_arguments_are_refused(tmp_path: Path, moving_frames: MakeFrames) -> None:
    for name, size, rate, message in (
        ("a.avi", (32, 16), 25, r"must end in \.y4m, \.mkv or \.mp4"),
        ("absent/a.mkv", (32, 16), 25, "does not exist"),
        ("a.mkv", (20000, 16), 25, "not supported"),
        ("a.mkv", (32, 16), Fraction(2 * 10**6), "frames per second are not supported"),
        ("a.mkv", (32, 16), Fraction(1, 2 * 10**6), "frames per second are not supported"),
    ):
        with pytest.raises(VideoError, match=message):
            create_video(tmp_path / name, size, rate)
    with pytest.raises(ValueError, match="frame_rate"):
        create_video(tmp_path / "a.mkv", (32, 16), 0)
    for suffix in (".y4m", ".mkv", ".mp4"):
        with pytest.raises(VideoError, match="no frames"):
            create_video(tmp_path / f"a{suffix}", (32, 16), 25).close()
    with create_video(tmp_path / "b.mkv", (32, 16), 25) as writer:
        writer.write(moving_frames(1, 32, 16)[0])
        with pytest.raises(ValueError, match=r"\(32, 16\) pixels, got \(16, 32\)"):
            writer.write(moving_frames(1, 16, 32)[0])
    assert os.listdir(tmp_path) == ["b.mkv"]


def test_full_disk_is_one_clear_error(tmp_path: Path) -> None:
    """When no byte more fits, each format says so in a line and leaves nothing behind."""
    script = """
        import resource, signal, sys
        import numpy as np
        from dvc.errors import VideoError
        from dvc.video import Frame, create_video
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (40000, 40000))
        rng = np.random.default_rng(0)
        for suffix in (".y4m", ".mkv", ".mp4"):
            try:
                with create_video(sys.argv[1] + "/a" + suffix, (96, 64), 25) as writer:
                    for _ in range(70):
                        writer.write(Frame(rng.integers(0, 256, (64, 96), dtype=np.uint8)))
            except VideoError as err:
                print(err)
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    expected = [f"cannot write {tmp_path}/a{suffix}: File too large" for suffix in (".y4m", ".mkv", ".mp4")]
    assert done.stdout.splitlines() == expected
    assert done.stderr == ""
    assert os.listdir(tmp_path) == []
