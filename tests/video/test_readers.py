"""Tests of everything that can be opened as a video."""

import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import cv2
import numpy as np
import pytest
from av.video.stream import VideoStream

from dvc.errors import VideoError
from dvc.video import Frame, exact_frame_rate, open_video, readers
from dvc.video.pixels import picture_from_frame
from dvc.video.readers import FrameLookup
from tests.clips import same_frame, same_frames, write_clip

MakeFrames = Callable[..., list[Frame]]


def write_raw(path: Path, frames: list[Frame]) -> None:
    path.write_bytes(b"".join(p.tobytes() for f in frames for p in (f.luma, *(f.chroma or ()))))


def write_images(folder: Path, images: list[np.ndarray], suffix: str = ".png") -> None:
    folder.mkdir(exist_ok=True)
    for index, image in enumerate(images):
        assert cv2.imwrite(str(folder / f"{index + 1}{suffix}"), image)


def write_container(
    path: Path,
    frames: list[Frame],
    codec: str,
    times: list[int] | None = None,
    pixel_format: str = "yuv420p",
    aspect: Fraction | None = None,
    rotation: int = 0,
) -> None:
    """Write frames with FFmpeg, at given times in 1/25 s."""
    with av.open(str(path), "w") as container:
        stream = cast(VideoStream, container.add_stream(codec, rate=25))
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, pixel_format
        stream.time_base = stream.codec_context.time_base = Fraction(1, 25)
        if rotation:
            stream.set_display_rotation(rotation)
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        for time, frame in zip(times or range(len(frames)), frames, strict=True):
            picture = picture_from_frame(frame, pixel_format)
            picture.pts, picture.time_base = time, Fraction(1, 25)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def silence() -> av.AudioFrame:
    samples = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format="s16", layout="mono")
    samples.sample_rate = 8000
    return samples


@pytest.mark.parametrize("size", [(16, 12), (7, 5), (1, 1)])
@pytest.mark.parametrize("suffix", [".yuv", ".RAW"])
def test_raw_files_need_size_and_rate(
    tmp_path: Path, moving_frames: MakeFrames, size: tuple[int, int], suffix: str
) -> None:
    frames = moving_frames(3, *size)
    path = tmp_path / f"a{suffix}"
    write_raw(path, frames)
    with open_video(path, size=size, frame_rate=12.5) as reader:
        assert (reader.info.num_frames, reader.info.frame_rate) == (3, Fraction(25, 2))
        assert same_frames(reader, frames)
    for missing in ({"size": size}, {"frame_rate": 25}):
        with pytest.raises(VideoError, match="requires the size"):
            open_video(path, **missing)  # type: ignore[arg-type]


def test_raw_file_of_another_size_is_refused(tmp_path: Path, moving_frames: MakeFrames) -> None:
    write_raw(tmp_path / "a.yuv", moving_frames(3, 16, 12))
    with pytest.raises(VideoError, match=r"864 bytes are not a whole number of 16x14 .* \(336 bytes each\)"):
        open_video(tmp_path / "a.yuv", size=(16, 14), frame_rate=25)
    with pytest.raises(VideoError, match="not supported"):
        open_video(tmp_path / "a.yuv", size=(10**6, 1), frame_rate=25)


def test_raw_file_that_shrinks_while_it_is_read_is_damaged(tmp_path: Path, moving_frames: MakeFrames) -> None:
    frames = moving_frames(3, 64, 64)
    write_raw(tmp_path / "a.yuv", frames)
    reader = iter(open_video(tmp_path / "a.yuv", size=(64, 64), frame_rate=25))
    assert same_frame(next(reader), frames[0])
    with (tmp_path / "a.yuv").open("r+b") as file:
        file.truncate(64 * 64 * 3)
    next(reader)
    with pytest.raises(VideoError, match="damaged after 2 frames"):
        next(reader)


def test_images_come_in_natural_order(tmp_path: Path) -> None:
    """10.png follows 9.png; other files and hidden ones are ignored."""
    write_images(tmp_path, [np.full((6, 8, 3), 20 * k, np.uint8) for k in range(11)])
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / ".0.png").write_text("no image")
    with open_video(tmp_path) as reader:
        got = [int(frame.luma[0, 0]) for frame in reader]
        assert (reader.info.num_frames, reader.info.frame_rate) == (11, 25)
        assert reader.info.notices[0] == "RGB converted to YCbCr BT.601 limited range"
        assert reader.info.notices[-1] == "images have no frame rate: 25 frames per second assumed"
    assert got == sorted(got)
    assert len(set(got)) == 11


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".tiff", ".bmp", ".ppm", ".webp"])
def test_image_formats_in_colour(tmp_path: Path, suffix: str) -> None:
    rows, columns = np.mgrid[:21, :35]
    image = np.stack([columns * 7, rows * 12, 255 - columns * 5], axis=-1).astype(np.uint8)
    write_images(tmp_path, [image, image], suffix)
    with open_video(tmp_path, frame_rate=30) as reader:
        frames = list(reader)
        full_range = reader.info.full_range
    assert full_range == (suffix == ".jpg")
    assert not any("frame rate" in notice for notice in reader.info.notices)
    expected = image @ np.array([0.114, 0.587, 0.299])
    if not full_range:
        expected = 16 + expected * 219 / 255
    assert [(f.width, f.height) for f in frames] == [(35, 21)] * 2
    assert np.abs(frames[0].luma - expected).mean() < 3


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_images_have_no_chroma(tmp_path: Path, suffix: str, dtype: type) -> None:
    values: np.ndarray = np.arange(256, dtype=dtype).reshape(16, 16) * (257 if dtype == np.uint16 else 1)
    write_images(tmp_path, [values], suffix)
    with open_video(tmp_path) as reader:
        frame = next(iter(reader))
        assert ("16-bit source reduced to 8 bits" in reader.info.notices) == (dtype == np.uint16)
    assert frame.chroma is None
    rounded = np.minimum((values.astype(int) + 128) >> 8, 255)
    assert np.array_equal(frame.luma, values if dtype == np.uint8 else rounded)


def test_image_names_are_taken_literally(tmp_path: Path) -> None:
    folder = tmp_path / "a:b %03d"
    write_images(folder, [np.full((4, 4), 200, np.uint8)])
    (folder / "1.png").rename(folder / "x%03d*.png")
    assert [int(f.luma[0, 0]) for f in open_video(folder)] == [200]


def test_bad_images_are_named(tmp_path: Path) -> None:
    colour, grey = np.full((6, 8, 3), 90, np.uint8), np.full((6, 8), 90, np.uint8)
    for name, images, message in (
        ("size", [colour, colour[:4]], r"2\.png: the picture size changes from 8x6 to 8x4"),
        ("grey", [colour, grey], r"2\.png: grey and colour pictures are mixed"),
        ("empty", [], "has no images"),
    ):
        write_images(tmp_path / name, images)
        with pytest.raises(VideoError, match=message):
            list(open_video(tmp_path / name))
    (tmp_path / "size" / "1.png").write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    with pytest.raises(VideoError, match=r"1\.png: "):
        open_video(tmp_path / "size")


@pytest.mark.parametrize("kind", ["mkv", "y4m", "yuv", "folder"])
def test_start_and_count_choose_a_part(tmp_path: Path, moving_frames: MakeFrames, kind: str) -> None:
    frames = moving_frames(6, 16, 12, grey=kind == "folder")
    path = tmp_path / f"a.{kind}"
    size, rate = None, None
    if kind == "folder":
        write_images(path, [f.luma for f in frames])
    elif kind == "yuv":
        size, rate = (16, 12), 25
        write_raw(path, frames)
    else:
        write_clip(path, frames)
    for start, count in ((0, 2), (3, None), (4, 9), (5, 1)):
        with open_video(path, size=size, frame_rate=rate, start=start, num_frames=count) as reader:
            assert same_frames(reader, frames[start : None if count is None else start + count])
    for start in (6, 100):
        with pytest.raises(VideoError, match=f"cannot start at frame {start}"):
            open_video(path, size=size, frame_rate=rate, start=start)


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "libx264"), ("a.avi", "mpeg4"), ("a.mov", "mjpeg")])
def test_usual_containers_open(tmp_path: Path, moving_frames: MakeFrames, name: str, codec: str) -> None:
    frames = moving_frames(8, 48, 32)
    pixel_format = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    write_container(tmp_path / name, frames, codec, pixel_format=pixel_format)
    with open_video(tmp_path / name) as reader:
        assert len(list(reader)) == 8
        info = reader.info
        assert (info.size, info.frame_rate, info.num_frames) == ((48, 32), Fraction(25), 8)
        assert info.full_range == (codec == "mjpeg")
    with open_video(tmp_path / name, frame_rate=29.97, start=5) as reader:
        assert (reader.info.frame_rate, reader.info.num_frames) == (Fraction(30000, 1001), 3)
    with pytest.raises(VideoError, match="pictures are 48x32, not 32x48"):
        open_video(tmp_path / name, size=(32, 48))


def test_variable_rate_and_odd_pixels_are_noted(tmp_path: Path, moving_frames: MakeFrames) -> None:
    """Frames have the times of their file, and the reader says so; a rate that is given takes their place."""
    frames = moving_frames(8, 48, 32)
    times = [0, 1, 2, 7, 8, 20, 21, 30]
    write_container(tmp_path / "a.mp4", frames, "libx264", times, aspect=Fraction(4, 3))
    with open_video(tmp_path / "a.mp4", frame_rate=25) as reader:
        assert {frame.time for frame in reader} == {None}
        assert "variable" not in str(reader.info.notices)
    with open_video(tmp_path / "a.mp4") as reader:
        assert [frame.time.seconds for frame in reader if frame.time] == [Fraction(t, 25) for t in times]
        assert reader.info.frame_rate < 10
        assert reader.info.notices == (
            "variable frame rate: time stamps are kept",
            "pixels are not square (4:3): taken as they are",
        )


def test_fields_and_rotation_are_noted(tmp_path: Path, moving_frames: MakeFrames) -> None:
    """Interlaced pictures and those to be shown turned come as they are stored, and the reader says so."""
    frame = moving_frames(1, 16, 12)[0]
    data = write_clip(tmp_path / "a.y4m", [frame]).read_bytes()
    (tmp_path / "a.y4m").write_bytes(data.replace(b" Ip ", b" It ", 1))
    with open_video(tmp_path / "a.y4m") as reader:
        assert reader.info.notices[0].startswith("interlaced source")
        assert same_frame(next(iter(reader)), frame)
    write_container(tmp_path / "a.mp4", [frame], "libx264", rotation=90)
    with open_video(tmp_path / "a.mp4") as reader:
        assert reader.info.size == (16, 12)
        assert "rotation" in reader.info.notices[0]


def test_first_video_stream_is_taken(tmp_path: Path, moving_frames: MakeFrames) -> None:
    first, second = moving_frames(3, 16, 16), moving_frames(3, 32, 16)
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        sound = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        streams = [container.add_stream("ffv1", rate=25) for _ in range(2)]
        for stream, frames in zip(streams, (first, second), strict=True):
            stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, "yuv420p"
        container.mux(sound.encode(silence()))
        for stream, frames in zip(streams, (first, second), strict=True):
            for index, frame in enumerate(frames):
                picture = picture_from_frame(frame, "yuv420p")
                picture.pts = index
                container.mux(stream.encode(picture))
            container.mux(stream.encode(None))
    assert same_frames(open_video(tmp_path / "a.mkv"), first)


def test_what_is_no_video_is_refused_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Absent, empty, text, sound and random files raise `VideoError`, and FFmpeg stays silent."""
    with av.open(str(tmp_path / "sound.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        container.mux(stream.encode(silence()))
    (tmp_path / "empty.mkv").touch()
    (tmp_path / "text.txt").write_text("hello\n" * 100)
    (tmp_path / "list.m3u8").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n")
    for name in ("noise.mp4", "noise.y4m", "noise.avi", "noise"):
        (tmp_path / name).write_bytes(np.random.default_rng(0).bytes(5000))
    header = b"YUV4MPEG2 W16 H16 F25:1 C420\n"
    (tmp_path / "header.y4m").write_bytes(header)
    (tmp_path / "giant.y4m").write_bytes(header.replace(b"W16 H16", b"W60000 H60000") + b"FRAME\n")
    for path in [tmp_path / "absent.mkv", *sorted(tmp_path.iterdir())]:
        with pytest.raises(VideoError, match=r"^[^\n]+$") as caught:
            open_video(path)
        assert str(path) in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_wrong_arguments_are_refused(tmp_path: Path) -> None:
    for name, value in (("start", -1), ("num_frames", 0), ("frame_rate", 0), ("size", (0, 4))):
        with pytest.raises(ValueError, match=name):
            open_video(tmp_path, **{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (29.97, Fraction(30000, 1001)),
        (23.976, Fraction(24000, 1001)),
        (59.94, Fraction(60000, 1001)),
        (25, 25),
        (12.5, Fraction(25, 2)),
        (30.0, 30),
        (Fraction(30000, 1001), Fraction(30000, 1001)),
    ],
)
def test_frame_rates_become_fractions(given: float | Fraction, expected: Fraction) -> None:
    assert exact_frame_rate(given) == expected


def test_rates_that_nothing_has_are_refused(tmp_path: Path, moving_frames: MakeFrames) -> None:
    path = write_clip(tmp_path / "a.y4m", moving_frames(1, 16, 12))
    path.write_bytes(path.read_bytes().replace(b" F25:1 ", b" F2000000:1 ", 1))
    with pytest.raises(VideoError, match=r"a\.y4m: 2e\+06 frames per second are not supported"):
        open_video(path)
    with open_video(path, frame_rate=25) as reader:
        assert reader.info.frame_rate == 25


def test_frame_size_that_changes_midway_is_refused(tmp_path: Path, moving_frames: MakeFrames) -> None:
    for name, size in (("a", (32, 16)), ("b", (16, 32))):
        write_container(tmp_path / f"{name}.h264", moving_frames(4, *size), "libx264")
    joined = tmp_path / "joined.h264"
    joined.write_bytes((tmp_path / "a.h264").read_bytes() + (tmp_path / "b.h264").read_bytes())
    reader = iter(open_video(joined))
    assert [next(reader).width for _ in range(4)] == [32] * 4
    with pytest.raises(VideoError, match="the picture size changes from 32x16 to 16x32"):
        next(reader)


@pytest.mark.parametrize("suffix", [".y4m", ".yuv", ".mkv"])
def test_memory_does_not_grow_with_the_video(tmp_path: Path, moving_frames: MakeFrames, suffix: str) -> None:
    frames = moving_frames(4, 128, 96)
    path = tmp_path / f"a{suffix}"
    (write_raw if suffix == ".yuv" else write_clip)(path, frames * 20)
    with open_video(path, size=(128, 96), frame_rate=25) as reader:
        next(iter(reader))
    tracemalloc.start()
    try:
        assert sum(1 for _ in open_video(path, size=(128, 96), frame_rate=25)) == 80
        assert tracemalloc.get_traced_memory()[1] < 12 * 128 * 96 * 3 // 2
    finally:
        tracemalloc.stop()


def test_reader_keeps_its_protocol(tmp_path: Path, moving_frames: MakeFrames) -> None:
    frames = moving_frames(4, 16, 16)
    reader = open_video(write_clip(tmp_path / "a.mkv", frames))
    assert same_frames([next(iter(reader)), next(iter(reader))], frames[:2])
    reader.close()
    reader.close()
    assert list(reader) == []


def test_real_sequences_open(shared_sequences: Path) -> None:
    expected = {"foreman_qcif15": ((176, 144), 15, 150), "stone": ((352, 288), 25, 83)}
    for name, (size, rate, count) in expected.items():
        with open_video(shared_sequences / f"{name}.mkv") as reader:
            info = reader.info
            assert (info.size, info.frame_rate, info.notices) == (size, rate, ())
            assert sum(1 for _ in reader) == count


def test_frames_are_found_in_any_order(
    tmp_path: Path, moving_frames: MakeFrames, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = moving_frames(6, 32, 24)
    path = write_clip(tmp_path / "clip.mkv", frames)
    starts: list[int] = []
    monkeypatch.setattr(
        readers, "open_video", lambda path, start: starts.append(start) or open_video(path, start=start)
    )
    with FrameLookup(path) as frame:
        for number in (0, 1, 1, 4, 5, 2, 3):
            assert same_frame(frame(number), frames[number])
        assert starts == [0, 2]
        with pytest.raises(VideoError, match=r"clip\.mkv has no frame 9"):
            frame(9)
    with FrameLookup(path) as frame, pytest.raises(VideoError, match=r"clip\.mkv"):
        frame(6)
