"""Recordings in segments: read as one stream, in order of names, whole or not."""

from pathlib import Path

import pytest

from dvc.config import VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord, RecordingReader, StreamReader, StreamWriter, open_stream

CONFIG = codec_config(VideoConfig(64, 48, 25, 1), gop={"length": 3})


def write(path: Path, key: bytes, form: Form = Form.BUFFERED, width: int = 64) -> None:
    """Write a segment of three groups with key frames that begin alike."""
    config = CONFIG if width == 64 else codec_config(VideoConfig(width, 48, 25, 1), gop={"length": 3})
    with path.open("wb") as file, StreamWriter(file, config, form) as writer:
        digest = 7 if form is Form.PUNCTURED else None
        writer.write_gop(GopRecord(1, key + b"0"))
        writer.write_gop(GopRecord(3, key + b"1", True, b"", (b"a", b"b"), digest))
        writer.write_gop(GopRecord(2, key + b"2", True, b"", (b"c",), digest))


def keys(reader: RecordingReader | StreamReader) -> list[str]:
    return [record.key.decode() for record in reader]


@pytest.fixture(params=[Form.BUFFERED, Form.PUNCTURED])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a folder of three segments, and files that are none."""
    for number in (10, 9, 11):
        write(tmp_path / f"day-{number}.dvc", f"{number}:".encode(), request.param)
    for name in ("day.mkv", ".day-12.dvc", "day-13.dvcx", "day-14.dvc.part"):
        (tmp_path / name).write_bytes(b"nothing")
    return tmp_path


def test_segments_are_read_in_order(folder: Path) -> None:
    """Numbers in names count as numbers; bytes, frames and groups are those of all segments."""
    with RecordingReader(folder) as reader:
        assert keys(reader) == [f"{segment}:{group}" for segment in (9, 10, 11) for group in range(3)]
        assert (reader.config, reader.missing) == (CONFIG, None)
        assert reader.num_bytes == sum(path.stat().st_size for path in folder.glob("day-*.dvc"))
        assert (reader.num_frames, len(reader.index.entries)) == (18, 9)
        assert [reader.index.gop_of(frame) for frame in (0, 5, 6, 7, 17)] == [0, 2, 3, 4, 8]


@pytest.mark.parametrize("number", range(10))
def test_reading_goes_on_with_any_group(folder: Path, number: int) -> None:
    with RecordingReader(folder) as reader:
        everything = keys(reader)
        reader.seek_gop(number)
        assert keys(reader) == everything[number:]
        with pytest.raises(ValueError, match="from 0 to 9, got 10"):
            reader.seek_gop(10)


def test_damage_names_its_segment(folder: Path) -> None:
    path = folder / "day-10.dvc"
    data = path.read_bytes()
    path.write_bytes(data.replace(b"10:1", b"10:x"))
    found: list[bytes] = []
    with RecordingReader(folder) as reader, pytest.raises(BitstreamError, match=r"^day-10\.dvc: record 2 "):
        found.extend(record.key for record in reader)
    assert found == [b"9:0", b"9:1", b"9:2", b"10:0"]


def test_unfinished_segments_are_read_as_far_as_they_go(folder: Path) -> None:
    path = folder / "day-10.dvc"
    data = path.read_bytes()
    path.with_name("day-12.dvc.part").write_bytes(data[: data.index(b"10:2")])
    assert RecordingReader(folder).missing is None
    with RecordingReader(folder, unfinished=True) as reader:
        assert keys(reader)[-3:] == ["11:2", "10:0", "10:1"]
        assert reader.num_frames == 18 + 4
        assert reader.missing is not None
        nothing, cut = reader.missing.split("; ")
        assert nothing == "day-14.dvc.part: not a dvc3d stream"
        assert cut.startswith("day-12.dvc.part: ")


@pytest.mark.parametrize("other", [{"width": 32}, {"form": Form.NO_FEEDBACK}])
def test_segments_of_other_recordings_are_refused(folder: Path, other: dict[str, int]) -> None:
    write(folder / "day-8.dvc", b"8:", **other)  # type: ignore[arg-type]
    with pytest.raises(BitstreamError, match=r"^day-9\.dvc: its configuration differs from that of day-8"):
        RecordingReader(folder)


def test_a_folder_without_segments_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BitstreamError, match="without segments"):
        RecordingReader(tmp_path)
    with pytest.raises(BitstreamError, match="cannot be read"):
        RecordingReader(tmp_path / "nowhere")


def test_streams_and_folders_are_opened(folder: Path) -> None:
    with open_stream(str(folder)) as reader:
        assert isinstance(reader, RecordingReader)
    with open_stream(str(folder / "day-9.dvc")) as one:
        assert keys(one) == ["9:0", "9:1", "9:2"]
