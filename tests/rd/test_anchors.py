"""Anchors: files of standard codecs, written by one process and measured by another."""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import BitstreamError, ConfigError, DvcError, VideoError
from dvc.rd.anchors import ANCHOR_CODECS, AnchorCodec, anchor_files
from dvc.rd.anchors.__main__ import main
from dvc.rd.anchors.anchor_files import (
    decode_file,
    encode_file,
    measure_file,
    nal_units,
    picture_bytes,
    without_overhead,
)
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.originals import CodeVersion, find_source
from dvc.rd.rd_results import POINTS_FOLDER, read_results
from dvc.rd.run_points import run_points
from dvc.rd.specification import Point, Task
from dvc.video import Frame, VideoReader, create_video, open_video
from dvc.video.pixels import picture_from_frame

NUM_FRAMES = 5
EVERY_CODEC = pytest.mark.parametrize("codec", ANCHOR_CODECS.values(), ids=lambda codec: codec.name)


def write_clip(path: Path, width: int, height: int, num_frames: int = NUM_FRAMES) -> Path:
    rng = np.random.default_rng(7)
    texture = np.kron(rng.integers(40, 210, (24, 24)), np.ones((4, 4))).astype(np.uint8)
    with create_video(path, (width, height), 25, luma_only=True) as writer:
        for index in range(num_frames):
            writer.write(Frame(texture[2 * index : 2 * index + height, index : index + width].copy()))
    return path


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("anchors") / "clip.mkv", 48, 32)


@EVERY_CODEC
@pytest.mark.parametrize(("width", "height", "num_frames"), [(48, 32, NUM_FRAMES), (47, 31, 3), (33, 18, 1)])
def test_files_are_what_is_measured(
    tmp_path: Path, codec: AnchorCodec, width: int, height: int, num_frames: int
) -> None:
    """Any size and number of frames decodes in order; the rate is the size of the file, bit for bit."""
    clip = write_clip(tmp_path / "clip.mkv", width, height, num_frames)
    file = tmp_path / f"stream{codec.suffix}"
    coded = encode_file(clip, file, codec, 24, luma_only=True)
    measured = measure_file(file, clip)
    totals, rows = measured["totals"], measured["per_frame"]
    assert coded["frames"] == totals["frames"] == len(rows) == num_frames
    assert coded["bytes"] == totals["stream_bytes"] == file.stat().st_size
    assert totals["rate_kbps"] == pytest.approx(8 * file.stat().st_size * 25 / num_frames / 1000)
    assert sum(totals["bits"].values()) == 8 * file.stat().st_size
    assert min(row["psnr_y_db"] for row in rows) > 30
    assert [row["index"] for row in rows] == list(range(num_frames))
    inter = 0 if codec.structure == "intra" else num_frames - 1
    assert [row["type"] for row in rows] == ["intra"] * (num_frames - inter) + ["inter"] * inter
    assert (measured["width"], measured["height"]) == (width, height)


@pytest.mark.parametrize("name", ["x264-medium", "x265-medium", "svtav1-6"])
def test_chroma_is_coded_unless_luma_is_asked_for(tmp_path: Path, name: str) -> None:
    noise = np.random.default_rng(3).integers(60, 200, (2, 16, 24)).astype(np.uint8)
    cb, cr = (cv2.GaussianBlur(plane, (0, 0), 3) for plane in noise)
    clip, codec = tmp_path / "clip.mkv", ANCHOR_CODECS[name]
    with create_video(clip, (48, 32), Fraction(25), luma_only=False) as writer:
        for level in (100, 104, 108):
            writer.write(Frame(np.full((32, 48), level, np.uint8), (cb, cr)))
    psnrs_db, sizes = [], []
    for luma_only in (True, False):
        file = tmp_path / f"{luma_only}{codec.suffix}"
        sizes.append(encode_file(clip, file, codec, 24, luma_only=luma_only)["bytes"])
        totals = measure_file(file, clip, luma_only=luma_only)["totals"]
        psnrs_db.append([totals.get(plane) for plane in ("psnr_cb_db", "psnr_cr_db", "psnr_yuv_db")])
    assert psnrs_db[0] == [None, None, None]
    assert min(psnrs_db[1]) > 35
    assert psnrs_db[1][2] == pytest.approx((6 * totals["psnr_y_db"] + sum(psnrs_db[1][:2])) / 8)
    assert sizes[0] < sizes[1]


@EVERY_CODEC
def test_coarser_quantization_needs_less(clip: Path, tmp_path: Path, codec: AnchorCodec) -> None:
    found = []
    for number, qp in enumerate((20, 44, 44)):
        file = tmp_path / f"{number}{codec.suffix}"
        encode_file(clip, file, codec, qp, luma_only=True)
        totals = measure_file(file, clip)["totals"]
        found.append((totals["stream_bytes"], totals["psnr_y_db"], file.read_bytes()))
    assert found[0][0] > found[1][0]
    assert found[0][1] > found[1][1]
    assert found[1] == found[2]


def test_time_of_reading_is_not_that_of_coding(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames that take long to read make coding no dearer, however many are read at once."""

    def slow(reader: VideoReader) -> Iterator[Frame]:
        for frame in reader._frames:
            until = time.process_time() + 0.2
            while time.process_time() < until:
                pass
            yield frame

    monkeypatch.setattr(VideoReader, "__iter__", slow)
    monkeypatch.setattr(anchor_files, "READ_AT_ONCE", 2)
    started = time.process_time()
    coded = encode_file(clip, tmp_path / "slow.264", ANCHOR_CODECS["x264-superfast"], 30)
    assert coded["frames"] == NUM_FRAMES
    assert 0 < coded["coding_cpu_s"] < time.process_time() - started - 0.2 * NUM_FRAMES


def test_qps_of_av1_cover_the_same_range() -> None:
    codec = ANCHOR_CODECS["svtav1"]
    qps = [codec.encoder_qp(qp) for qp in range(1, 52)]
    assert qps == sorted(qps)
    assert (qps[0], qps[19], qps[43], qps[50]) == (1, 14, 54, 63)
    assert ANCHOR_CODECS["x265"].encoder_qp(37) == 37
    with pytest.raises(ConfigError, match="must be 1 to 51, got 52"):
        codec.encoder_qp(52)


def test_intra_frames_come_in_their_period(tmp_path: Path) -> None:
    """With a period of 16, frames 0, 16 and 32 are intra and no other, which costs more."""
    clip, sizes = write_clip(tmp_path / "long.mkv", 48, 32, 33), {}
    for name in ("x264-ippp", "x264-ippp-16"):
        file = tmp_path / f"{name}.264"
        encode_file(clip, file, ANCHOR_CODECS[name], 30)
        measured = measure_file(file, clip)
        intra = [row["index"] for row in measured["per_frame"] if row["type"] == "intra"]
        assert intra == ([0, 16, 32] if name == "x264-ippp-16" else [0])
        sizes[name] = measured["totals"]["stream_bytes"]
    assert sizes["x264-ippp-16"] > sizes["x264-ippp"]


def _frame_types(path: Path) -> str:
    """Return I, P or B of each picture, in the order of display."""
    with av.open(str(path)) as container:
        return "".join(
            av.video.frame.PictureType(frame.pict_type).name for frame in container.decode(video=0)
        )


def _num_references(path: Path) -> int:
    """Read how many references x264 may use from its sequence parameter set."""
    data = path.read_bytes()
    start = data.index(b"\x00\x00\x01\x67") + 7
    bits = "".join(f"{byte:08b}" for byte in data[start : start + 16])

    def _exp_golomb() -> int:
        nonlocal bits
        zeros = bits.index("1")
        value, bits = int(bits[: 2 * zeros + 1], 2) - 1, bits[2 * zeros + 1 :]
        return value

    assert data[start - 3] == 100  # profile High
    _exp_golomb()  # number of the set
    for _ in range(3):
        _exp_golomb()  # format of chroma, depths
    assert bits[:2] == "00"
    bits = bits[2:]
    _exp_golomb()  # size of frame numbers
    if _exp_golomb() == 0:
        _exp_golomb()  # size of the order of display
    return _exp_golomb()


@pytest.mark.parametrize(
    ("name", "types", "references"),
    [
        ("x264-ippp", {"I", "P"}, 1),
        ("x264-superfast-no-asm", {"I", "P"}, 1),
        ("x264-medium", {"I", "P", "B"}, 4),
        ("x264-slower", {"I", "P", "B"}, 8),
        ("x265", {"I", "P"}, None),
        ("x265-medium", {"I", "P", "B"}, None),
    ],
)
def test_files_have_the_frame_types_and_references_of_the_preset(
    tmp_path: Path, name: str, types: set[str], references: int | None
) -> None:
    clip = write_clip(tmp_path / "long.mkv", 48, 32, 25)
    file = tmp_path / f"file{ANCHOR_CODECS[name].suffix}"
    encode_file(clip, file, ANCHOR_CODECS[name], 30)
    found = _frame_types(file)
    assert (found[0], found.count("I"), set(found)) == ("I", 1, types)
    assert references in (None, _num_references(file) if file.suffix == ".264" else None)


def test_av1_with_random_access_waits_for_later_frames(tmp_path: Path) -> None:
    """Preset 6 shows frames that it coded earlier, which low delay never does."""
    clip = write_clip(tmp_path / "long.mkv", 64, 32, 25)
    with open_video(clip) as reader:
        frames, info = [frame.without_chroma() for frame in reader], reader.info

    def _num_taken(name: str) -> int:
        encoder = anchor_files._open(ANCHOR_CODECS[name], 30, info.size, info.frame_rate, "yuv420p")
        for count, frame in enumerate(frames):
            picture = picture_from_frame(frame, "yuv420p")
            picture.pts = count
            if encoder.encode(picture):
                return count
        return len(frames)

    assert _num_taken("svtav1-6") > _num_taken("svtav1")


@EVERY_CODEC
def test_missing_encoder_is_named(
    clip: Path, tmp_path: Path, codec: AnchorCodec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(av, "codecs_available", set())
    with pytest.raises(ConfigError, match=f"{codec.name}: .* without the encoder {codec.library}"):
        encode_file(clip, tmp_path / f"x{codec.suffix}", codec, 30, luma_only=True)


@pytest.mark.parametrize("name", ["x264-ippp", "x265", "svtav1"])
def test_damaged_files_are_refused(clip: Path, tmp_path: Path, name: str) -> None:
    codec = ANCHOR_CODECS[name]
    file = tmp_path / f"whole{codec.suffix}"
    encode_file(clip, file, codec, 30, luma_only=True)
    data, rng = file.read_bytes(), np.random.default_rng(5)
    other = tmp_path / f"other{codec.suffix}"
    for position in rng.integers(0, len(data), 12):
        changed = bytearray(data)
        changed[position] ^= 1 << int(rng.integers(8))
        for damaged in (data[:position], bytes(changed)):
            other.write_bytes(damaged)
            with suppress(DvcError):
                list(decode_file(other))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["encode", "{clip}", "{out}.mkv", "--codec", "x264-intra", "--qp", "30"], "ends in .264"),
        (["encode", "{clip}", "{out}.264", "--codec", "x264-intra", "--qp", "52"], "1 to 51"),
        (["encode", "nowhere.mkv", "{out}.264", "--codec", "x264-intra", "--qp", "30"], "no such file"),
        (["encode", "{clip}", "{clip}", "--codec", "x264-intra", "--qp", "30"], "also an input"),
        (
            ["encode", "{clip}", "{out}.264", "--codec", "x264-intra", "--qp", "30", "--json", "{out}.264"],
            "x.264 is also an input or another output",
        ),
        (["decode", "x.264", "--reference", "{clip}", "--json", "{clip}"], "also an input"),
        (["decode", "{clip}", "--reference", "{clip}"], "expected .264 or .265 or .obu"),
        (["decode", "nowhere.264", "--reference", "{clip}"], "nowhere.264"),
    ],
)
def test_bad_input_is_one_line(
    clip: Path, tmp_path: Path, arguments: list[str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    words = [word.format(clip=clip, out=tmp_path / "x") for word in arguments]
    with pytest.raises(SystemExit, match="2"):
        sys.exit(main(words))
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert message in error


def test_originals_of_another_size_or_length_are_refused(clip: Path, tmp_path: Path) -> None:
    file = tmp_path / "x.264"
    encode_file(clip, file, ANCHOR_CODECS["x264-intra"], 30)
    with pytest.raises(VideoError, match="not \\(30, 48\\)"):
        measure_file(file, write_clip(tmp_path / "low.mkv", 48, 30))
    with pytest.raises(VideoError, match="more than the 2 pictures of the original"):
        measure_file(file, write_clip(tmp_path / "short.mkv", 48, 32, 2))


def test_anchors_are_measured_by_processes(clip: Path, tmp_path: Path) -> None:
    """Results and pictures of one anchor; another has an encoder that refuses the pictures."""
    points = [Point(str(clip), "x264-ippp", None, "30", 0, start=1, frames=3, luma_only=True)]
    tiny = write_clip(tmp_path / "tiny.mkv", 3, 3, 1)
    points.append(Point(str(tiny), "svtav1", None, "30", 0))
    summary = run_points(points, tmp_path, tmp_path)
    assert summary.num_measured == 1
    assert [reason for _, reason in summary.failures] == [
        "dvc.rd.anchors: libsvtav1 does not code 3x3 pictures in this way"
    ]
    (result,) = read_results(tmp_path)
    data = json.loads((tmp_path / POINTS_FOLDER / f"{result.name}.json").read_text(encoding="utf-8"))
    assert data["proof"]["decoded_by"] == "FFmpeg"
    assert data["totals"]["frames"] == 3
    assert data["config"]["parameters"]["keyint"] == "infinite"
    assert data["config"]["libraries"]["libx264"] == "165"
    assert "dvc.rd.anchors decode stream.264 --reference clip.mkv" in data["commands"][1]
    assert str(clip.parent) not in json.dumps(data)
    pictures = result.pictures
    assert pictures is not None
    assert (pictures.index, pictures.predicted) == (1, None)
    with (
        open_video(clip, start=2, num_frames=1) as frames,
        open_video(tmp_path / str(pictures.original)) as originals,
    ):
        assert np.array_equal(next(iter(frames)).luma, next(iter(originals)).luma)
    assert (tmp_path / str(pictures.decoded)).read_bytes().startswith(b"\x89PNG")
    assert len(list((tmp_path / "pictures").iterdir())) == 2


def test_anchors_do_not_change_with_the_codec(clip: Path) -> None:
    source = find_source(str(clip), clip.parent, ProcessGroup())
    versions = (CodeVersion("1", "a"), CodeVersion("2", "b"))
    anchor, codec = Point(str(clip), "x265", None, "30", 0), Point(str(clip), "2d", 1, "auto", 2)
    assert len({Task(anchor, source, code).identity for code in versions}) == 1
    assert len({Task(codec, source, code).identity for code in versions}) == 2


SPS, SEI, SLICE = (b"\0\0\0\1" + bytes([first, 0x80]) for first in (0x67, 0x06, 0x65))


def test_units_are_split_counted_and_left_out() -> None:
    """Start codes have three or four bytes; messages and repeated parameter sets are left out."""
    assert nal_units(SPS + SLICE[1:] + SEI) == [SPS, SLICE[1:], SEI]
    assert nal_units(b"") == []
    assert without_overhead(SPS + SEI + SLICE, "h264") == SPS + SLICE
    assert without_overhead(SPS[1:] + SEI + SLICE, "h264", header=SPS) == SLICE
    assert without_overhead(b"\x12\0", "obu") == b"\x12\0"
    assert picture_bytes(SPS + SEI + SLICE, "h264") == len(SLICE)
    assert picture_bytes(b"\0\0\1\x26\1\xff" + b"\0\0\1\x42\1", "hevc") == 6
    # A temporal delimiter, a sequence header of two bytes and a frame of three bytes.
    assert picture_bytes(b"\x12\0" + b"\x0a\2ab" + b"\x32\3abc", "obu") == 5


@pytest.mark.parametrize("stream", [b"\x12", b"\x32\5abc", b"\x32\x80", b"\x32" + b"\xff" * 9])
def test_wrong_lengths_are_refused(stream: bytes) -> None:
    with pytest.raises(BitstreamError, match="AV1"):
        picture_bytes(stream, "obu")


@given(st.binary(max_size=60), st.sampled_from(["h264", "hevc", "obu"]))
def test_any_bytes_are_counted_or_refused(stream: bytes, file_format: str) -> None:
    try:
        assert 0 <= picture_bytes(stream, file_format) <= len(stream)
    except BitstreamError:
        return
