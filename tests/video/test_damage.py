"""Tests of damaged and cut video files: frames up to the damage, then one clear error."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dvc.errors import VideoError
from dvc.video import Frame, open_video
from dvc.video.decoding import HEAD_BYTES, checksum_is_valid, ffv1_slices, matroska_bytes
from tests.clips import same_frame, write_clip

MakeFrames = Callable[..., list[Frame]]


def read_all(path: Path) -> tuple[list[Frame], str]:
    """Read what can be read; return the frames, and the error or nothing."""
    frames = []
    try:
        with open_video(path) as reader:
            for frame in reader:
                frames.append(frame)
    except VideoError as err:
        return frames, str(err)
    return frames, ""


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory, moving_frames: MakeFrames) -> dict[str, Path]:
    folder, frames = tmp_path_factory.mktemp("intact"), moving_frames(12, 64, 48)
    return {suffix: write_clip(folder / f"a{suffix}", frames) for suffix in (".y4m", ".mkv", ".mp4")}


@pytest.mark.parametrize("suffix", [".y4m", ".mkv", ".mp4"])
@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.8, 0.99])
def test_cut_file_gives_its_frames_and_then_an_error(
    tmp_path: Path, intact: dict[str, Path], suffix: str, share: float
) -> None:
    data = intact[suffix].read_bytes()
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(data[: int(len(data) * share)])
    whole, _ = read_all(intact[suffix])
    frames, error = read_all(path)
    assert str(path) in error
    assert "\n" not in error
    assert len(frames) <= len(whole)
    if suffix == ".mp4":
        return  # lossy: the last picture may lack references without any sign of it
    assert len(frames) >= int(share * len(whole)) - 1
    assert all(same_frame(a, b) for a, b in zip(frames, whole, strict=False))


def test_every_damaged_slice_of_ffv1_is_found(tmp_path: Path, intact: dict[str, Path]) -> None:
    """A flipped bit in the coded samples of a frame ends the video before that frame."""
    data = bytearray(intact[".mkv"].read_bytes())
    whole, _ = read_all(intact[".mkv"])
    rng = np.random.default_rng(3)
    found = 0
    for position in rng.integers(len(data) // 20, len(data) * 19 // 20, 60):
        damaged = data.copy()
        damaged[position] ^= 1 << rng.integers(8)
        (tmp_path / "a.mkv").write_bytes(damaged)
        frames, error = read_all(tmp_path / "a.mkv")
        assert all(same_frame(a, b) for a, b in zip(frames, whole, strict=False)) or not error
        found += bool(error)
    # A few bits belong to Matroska's element headers, which have no checksum.
    assert found >= 57


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), suffix=st.sampled_from([".y4m", ".mkv", ".mp4"]))
def test_damage_anywhere_raises_nothing_but_video_error(
    tmp_path: Path, intact: dict[str, Path], seed: int, suffix: str
) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(intact[suffix].read_bytes())
    region = min(len(data), 900) if seed % 2 else len(data)
    for position in rng.integers(0, region, 5):
        data[position] = rng.integers(256)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    frames, _ = read_all(path)
    assert len(frames) < 200


def test_matroska_states_its_length(intact: dict[str, Path], tmp_path: Path) -> None:
    """The length in the file's own header is that of the file; a live recording has none."""
    data = intact[".mkv"].read_bytes()
    assert matroska_bytes(data[:HEAD_BYTES]) == len(data)
    position = data.index(b"\x18\x53\x80\x67") + 4
    (tmp_path / "live.mkv").write_bytes(data[:position] + b"\x01" + b"\xff" * 7 + data[position + 8 :])
    assert matroska_bytes((tmp_path / "live.mkv").read_bytes()[:HEAD_BYTES]) is None
    assert read_all(tmp_path / "live.mkv")[1] == ""
    for content in (b"", data[:4], data[:6], data[:position], b"text" * 100):
        assert matroska_bytes(content) is None


def test_checksum_is_that_of_ffv1() -> None:
    """The value is CRC-32 from 0, most significant bit first, as the plain definition gives it."""
    data = np.random.default_rng(0).bytes(50)
    remainder = 0
    for byte in data:
        remainder ^= byte << 24
        for _ in range(8):
            remainder = (remainder << 1) ^ (0x104C11DB7 if remainder & 0x80000000 else 0)
    assert checksum_is_valid(data + remainder.to_bytes(4, "big"))
    assert not checksum_is_valid(data + (remainder ^ 1).to_bytes(4, "big"))


def test_slices_are_split_from_the_end() -> None:
    first, second = b"abc" + b"\x00\x00\x03" + bytes(5), b"\x00\x00\x00" + bytes(5)
    assert ffv1_slices(first + second) == [second, first]
    assert ffv1_slices(b"x" + first) is None
