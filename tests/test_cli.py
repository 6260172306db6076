"""The commands on small, odd and wrong input: the right result, or one line, status 2 and no output."""

import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import decoder.__main__
import dvc
import encoder.__main__
from dvc import cli
from dvc.config import DEFAULT_CODEC, VARIANTS
from dvc.errors import ConfigError, DvcError
from dvc.stream import StreamReader
from dvc.video import open_video
from tests.clips import moving_texture, write_clip

QUICK = ("--quiet", "--wz-q", "1", "--luma-only")


def encode(*arguments: object) -> int:
    return encoder.__main__.main([*map(str, arguments), *QUICK])


def encode_2d(*arguments: object) -> int:
    """Encode groups of two frames."""
    return encode(*arguments, "--codec", "2d")


def decode(*arguments: object) -> int:
    return decoder.__main__.main([*map(str, arguments), "--quiet"])


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.y4m", moving_texture(5, 16, 24))


@pytest.fixture(scope="module")
def stream(clip: Path) -> Path:
    assert encode_2d(clip, clip.with_suffix(".dvc")) == 0
    return clip.with_suffix(".dvc")


def one_line_of(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1, captured.err
    return captured.err


@pytest.mark.parametrize("codec", [DEFAULT_CODEC, "2d"])
@pytest.mark.parametrize("num_frames", [1, 2, 3])
def test_short_sequences_are_coded(tmp_path: Path, clip: Path, num_frames: int, codec: str) -> None:
    """One frame is a key frame, two are two key frames, three may have a Wyner-Ziv frame in the middle."""
    assert encode(clip, tmp_path / "s.dvc", "--frames", num_frames, "--codec", codec) == 0
    assert decode(tmp_path / "s.dvc", tmp_path / "s.y4m", "--json", tmp_path / "s.json") == 0
    with open_video(tmp_path / "s.y4m") as reader:
        assert len(list(reader)) == num_frames
    types = [frame["type"] for frame in json.loads((tmp_path / "s.json").read_text())["per_frame"]]
    if codec == "2d":
        assert types == [["key"], ["key", "key"], ["key", "wz", "key"]][num_frames - 1]
    else:  # no track lasts in so small a frame
        assert types == ["key"] * num_frames


@pytest.mark.parametrize("codec", [DEFAULT_CODEC, "2d"])
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 50), (17, 23)])
def test_any_size_is_coded(tmp_path: Path, shape: tuple[int, int], codec: str) -> None:
    """Sides below a block, odd sides and sides that are not multiples of 4 come back as they were."""
    clip = write_clip(tmp_path / "clip.y4m", moving_texture(3, *shape))
    assert encode(clip, tmp_path / "s.dvc", "--codec", codec) == 0
    assert decode(tmp_path / "s.dvc", tmp_path / "s.y4m", "--reference", clip) == 0
    with open_video(tmp_path / "s.y4m") as reader:
        assert (reader.info.height, reader.info.width) == shape
        assert len(list(reader)) == 3


def test_start_and_frames_select_what_is_coded(tmp_path: Path, clip: Path) -> None:
    """Lossless key frames from frame 1 on are frames 1, 2 and 3 of the original, at its frame rate."""
    options = ["--gop", "1", "--key-qp", "lossless", "--start", "1", "--frames", "3"]
    assert encode(clip, tmp_path / "s.dvc", *options) == 0
    assert decode(tmp_path / "s.dvc", tmp_path / "s.y4m", "--reference", clip, "--reference-start", 1) == 0
    with open_video(tmp_path / "s.y4m") as decoded, open_video(clip, start=1, num_frames=3) as original:
        assert decoded.info.frame_rate == Fraction(25)
        for a, b in zip(decoded, original, strict=True):
            np.testing.assert_array_equal(a.luma, b.luma)


def test_raw_video_and_hierarchical_gops(tmp_path: Path) -> None:
    """Raw 4:2:0 samples of a given size and rate are coded, in colour and with hierarchical GOPs."""
    frames = moving_texture(5, 16, 24)
    planes = [plane for frame in frames for plane in (frame.luma, *(frame.chroma or ()))]
    (tmp_path / "raw.yuv").write_bytes(b"".join(plane.tobytes() for plane in planes))
    options = [
        "--size",
        "24x16",
        "--frame-rate",
        "30000/1001",
        "--gop",
        "4",
        "--references",
        "hierarchical",
        "--wz-q",
        "1",
    ]
    assert encoder.__main__.main([str(tmp_path / "raw.yuv"), str(tmp_path / "s.dvc"), *options]) == 0
    assert decode(tmp_path / "s.dvc", tmp_path / "s.y4m") == 0
    with open_video(tmp_path / "s.y4m") as reader:
        assert reader.info.frame_rate == Fraction(30000, 1001)
        decoded = list(reader)
    assert len(decoded) == 5
    assert all(frame.chroma is not None for frame in decoded)


BAD_INPUT = [
    ("encode nothing.mkv o.dvc", "nothing.mkv"),
    ("encode garbage.mkv o.dvc", "garbage.mkv"),
    ("encode empty.y4m o.dvc", "empty.y4m"),
    ("encode void.mkv o.dvc", "void.mkv"),
    ("encode folder o.dvc", "folder"),
    ("encode clip.y4m o.dvc --start 5", "start"),
    ("encode clip.y4m clip.y4m", "input"),
    ("encode clip.y4m o.dvc --json o.dvc", "another output"),
    ("encode clip.y4m none/o.dvc", "folder does not exist"),
    ("encode clip.y4m folder", "is a folder"),
    ("encode clip.y4m", "OUTPUT or --serve"),
    ("encode clip.y4m o.dvc --serve :0", "OUTPUT or --serve"),
    ("encode raw.yuv o.dvc", "size"),
    ("encode raw.yuv o.dvc --size 4x4", "frame rate"),
    ("encode raw.yuv o.dvc --size 9x9 --frame-rate 25", "raw.yuv"),
    ("encode clip.y4m o.dvc --qp 30 --wz-q 4", "--qp excludes --wz-q"),
    ("encode clip.y4m --serve localhost", "HOST:PORT"),
    ("encode clip.y4m --serve :0 --leave-out", "--leave-out requires a camera"),
    ("encode clip.y4m a.dvc --token-file token", "--token-file requires --serve"),
    ("encode clip.y4m a-%04d.dvc", "a-%04d.dvc requires --segment"),
    ("encode clip.y4m o.dvc --codec 2d --points 9", "requires --codec"),
    ("encode clip.y4m --serve :0 --tls-key k", "requires --tls-cert"),
    ("encode clip.y4m out.dvc --queue 16", "--queue requires --serve"),
    ("encode clip.y4m --serve 192.0.2.1:0", "cannot listen"),
    ("decode nothing.dvc o.y4m", "nothing.dvc"),
    ("decode clip.y4m o.y4m", "not a dvc3d stream"),
    ("decode void.mkv o.y4m", "void.mkv: not a dvc3d stream"),
    ("decode folder o.y4m", "folder"),
    ("decode s.dvc", "INPUT and OUTPUT"),
    ("decode s.dvc o.y4m p.y4m", "INPUT and OUTPUT"),
    ("decode s.dvc o.y4m --connect :1", "expected OUTPUT"),
    ("decode s.dvc o.txt", "o.txt"),
    ("decode s.dvc s.dvc", "input"),
    ("decode s.dvc o.y4m --punctured s.dvc", "input"),
    ("decode s.dvc o.y4m --path-regularity -1", "path_regularity"),
    ("decode s.dvc o.y4m --path-regularity nan", "path_regularity"),
    ("decode s.dvc o.y4m --side-information-video o.y4m", "another"),
    ("decode s.dvc o.y4m --side-information-video o.avi", "o.avi"),
    ("decode s.dvc clip.y4m --reference clip.y4m", "input"),
    ("decode s.dvc none/o.y4m", "folder does not exist"),
    ("decode s.dvc o.y4m --side-information magic", "mci"),
    ("decode s.dvc o.y4m --reference large.y4m", "24x18"),
    ("decode s.dvc o.y4m --reference short.y4m", "reference ends before frame 4"),
    ("decode s.dvc o.y4m --reference none.y4m", "none.y4m"),
    ("decode s.dvc o.y4m --frames 3:3", "holds no frame; the stream has 5"),
    ("decode s.dvc o.y4m --frames 5:", "--frames 5: holds no frame"),
    ("decode s.dvc o.y4m --frames 1: --punctured p.dvc", "--punctured"),
    ("decode o.y4m --frames 1: --connect :1", "--connect"),
    ("decode o.y4m --connect 127.0.0.1:1 --timeout 1", "no program listens"),
]

BAD_ARGUMENTS = [
    "encode clip.y4m o.dvc --wz",
    "encode clip.y4m o.dvc --codec 4d",
    "encode clip.y4m o.dvc --frames 0",
    "encode clip.y4m o.dvc --key-qp 52",
    "encode clip.y4m o.dvc --key-qp good",
    "encode clip.y4m o.dvc --qp 52",
    "encode clip.y4m o.dvc --wz-q 9",
    "encode clip.y4m o.dvc --size 4by4",
    "encode clip.y4m o.dvc --frame-rate 0",
    "encode clip.y4m o.dvc --frame-rate 1/0",
    "encode clip.y4m o.dvc --frame-rate fast",
    "encode",
    "decode s.dvc o.y4m --frames=-1:3",
    "decode s.dvc o.y4m --frames=3",
    "decode s.dvc o.y4m --frames=1:2:3",
    "decode s.dvc o.y4m --frames=a:b",
    "decode s.dvc o.y4m --frames=",
    "decode s.dvc o.y4m --frames=1.5:",
]


@pytest.fixture
def desk(tmp_path: Path, clip: Path, stream: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working folder with good and bad files in it."""
    (tmp_path / "clip.y4m").write_bytes(clip.read_bytes())
    (tmp_path / "s.dvc").write_bytes(stream.read_bytes())
    (tmp_path / "garbage.mkv").write_bytes(bytes(range(256)) * 40)
    (tmp_path / "void.mkv").touch()
    (tmp_path / "empty.y4m").write_bytes(b"YUV4MPEG2 W24 H16 F25:1 C420jpeg\n")
    (tmp_path / "raw.yuv").write_bytes(bytes(30))
    (tmp_path / "folder").mkdir()
    write_clip(tmp_path / "large.y4m", moving_texture(5, 18, 24))
    write_clip(tmp_path / "short.y4m", moving_texture(4, 16, 24))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


COMMANDS = {"encode": encode, "decode": decode}


@pytest.mark.parametrize(("line", "words"), BAD_INPUT)
def test_bad_input_is_refused(desk: Path, capsys: pytest.CaptureFixture[str], line: str, words: str) -> None:
    """The problem is reported in one line with status 2, and no file is made or changed."""
    before = contents(desk)
    name, *arguments = line.split()
    assert COMMANDS[name](*arguments) == 2
    assert words in one_line_of(capsys)
    assert contents(desk) == before


@pytest.mark.parametrize("line", BAD_ARGUMENTS)
def test_bad_arguments_are_refused(desk: Path, capsys: pytest.CaptureFixture[str], line: str) -> None:
    """Arguments that cannot be parsed are refused in one line with status 2."""
    before = contents(desk)
    name, *arguments = line.split()
    with pytest.raises(SystemExit) as stop:
        COMMANDS[name](*arguments)
    assert stop.value.code == 2
    message = one_line_of(capsys)
    assert message.startswith(f"dvc-{name}: ")
    assert "--frames=" not in line or "expected A:B, A: or :B" in message
    assert contents(desk) == before


def damaged_copies(data: bytes) -> list[bytes]:
    """Cut and flip a stream at places from its front to its end."""
    places = np.linspace(0, len(data) - 1, 12).astype(int).tolist()
    flipped = [data[:k] + bytes([data[k] ^ 0x10]) + data[k + 1 :] for k in places]
    return [*(data[:k] for k in places), *flipped, data + b"\0"]


def test_damaged_streams_are_refused(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for damaged in damaged_copies((desk / "s.dvc").read_bytes()):
        (desk / "damaged.dvc").write_bytes(damaged)
        assert decode("damaged.dvc", "o.y4m") == 2
        assert one_line_of(capsys).startswith("dvc-decode: ")
        assert not (desk / "o.y4m").exists()


def test_frames_of_a_pipe_are_refused(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo("pipe.dvc")

    def write() -> None:
        with suppress(BrokenPipeError):
            (desk / "pipe.dvc").write_bytes((desk / "s.dvc").read_bytes())

    writer = threading.Thread(target=write)
    writer.start()
    assert decode("pipe.dvc", "o.y4m", "--frames", "1:") == 2
    writer.join()
    assert "pipe.dvc: a stream from a pipe has no index" in one_line_of(capsys)
    assert not (desk / "o.y4m").exists()


def test_frames_before_and_after_damage(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Damage in groups that are not needed harms nothing; elsewhere, and in the index, it is named."""
    with StreamReader(desk / "s.dvc") as reader:
        places = [entry.offset + entry.size // 2 for entry in reader.index.entries]
        records = list(reader)
    data = (desk / "s.dvc").read_bytes()
    (desk / "damaged.dvc").write_bytes(
        data[: places[1]] + bytes([data[places[1]] ^ 1]) + data[places[1] + 1 :]
    )
    assert [record.num_frames for record in records] == [1, 2, 2]
    assert decode("damaged.dvc", "first.y4m", "--frames", ":1") == 0
    assert decode("damaged.dvc", "o.y4m", "--frames", "1:2") == 2
    assert "damaged.dvc: record 2" in one_line_of(capsys)
    assert not (desk / "o.y4m").exists()
    (desk / "cut.dvc").write_bytes(data[:-1])
    assert decode("cut.dvc", "o.y4m", "--frames", ":1") == 2
    assert one_line_of(capsys).startswith("dvc-decode: cut.dvc: ")


def test_salvage_keeps_what_came_before_the_damage(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The groups of pictures before a damaged one are written, and the status is 2 all the same."""
    with StreamReader(desk / "s.dvc") as reader:
        sizes = [len(record.key) + sum(map(len, record.wyner_ziv)) for record in reader]
    data = (desk / "s.dvc").read_bytes()
    (desk / "cut.dvc").write_bytes(data[: len(data) - sizes[-1] // 2])
    assert decode("s.dvc", "whole.y4m") == 0
    assert decode("cut.dvc", "kept.y4m", "--salvage") == 2
    assert "(frames kept: 3)" in one_line_of(capsys)
    kept, whole = (desk / "kept.y4m").read_bytes(), (desk / "whole.y4m").read_bytes()
    assert whole.startswith(kept)
    with open_video(desk / "kept.y4m") as video:
        assert len(list(video)) == 3


def test_salvage_of_nothing_writes_nothing(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = (desk / "s.dvc").read_bytes()
    with StreamReader(desk / "s.dvc") as reader:
        first_key = data.index(next(iter(reader)).key)
    (desk / "cut.dvc").write_bytes(data[: first_key + 1])
    assert decode("cut.dvc", "kept.y4m", "--salvage") == 2
    assert one_line_of(capsys).startswith("dvc-decode: cut.dvc: lost: record 1 ")
    assert not (desk / "kept.y4m").exists()


def test_unfinished_stream_is_decoded_with_a_word_of_what_is_missing(
    desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The finished groups of a cut stream are written, whole or in part, and the status is 0."""
    with StreamReader(desk / "s.dvc") as reader:
        last = reader.index.entries[-1]
    (desk / "s.dvc.part").write_bytes((desk / "s.dvc").read_bytes()[: last.offset + last.size // 2])
    assert decode("s.dvc", "whole.y4m", "--unfinished") == 0
    assert capsys.readouterr().err == ""
    assert decode("s.dvc.part", "kept.y4m", "--unfinished") == 0
    line = one_line_of(capsys)
    assert line.startswith("dvc-decode: s.dvc.part: unfinished: record 3 ")
    assert "(groups of pictures before it: 2, frames: 3)" in line
    assert (desk / "whole.y4m").read_bytes().startswith((desk / "kept.y4m").read_bytes())
    assert decode("s.dvc.part", "two.y4m", "--unfinished", "--frames", "1:", "--punctured", "p.dvc") == 2
    capsys.readouterr()
    assert decode("s.dvc.part", "two.y4m", "--unfinished", "--frames", "1:") == 0
    assert "unfinished" in one_line_of(capsys)
    for video, count in (("kept.y4m", 3), ("two.y4m", 2)):
        with open_video(desk / video) as frames:
            assert len(list(frames)) == count
    assert decode("s.dvc.part", "o.y4m") == 2
    assert not (desk / "o.y4m").exists()


def test_stream_without_finished_group_is_refused(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a finished group of pictures nothing is written, even with --unfinished."""
    with StreamReader(desk / "s.dvc") as reader:
        first = reader.index.entries[0]
    for cut in (3, first.offset - 1, first.offset, first.offset + first.size - 1):
        (desk / "cut.dvc").write_bytes((desk / "s.dvc").read_bytes()[:cut])
        for part in ((), ("--frames", ":1")):
            assert decode("cut.dvc", "o.y4m", "--unfinished", *part) == 2
            assert one_line_of(capsys).startswith("dvc-decode: cut.dvc: ")
            assert not (desk / "o.y4m").exists()


def test_punctured_stream_refuses_another_method(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A punctured stream holds what one method needed, so that no other can decode it."""
    assert decode("s.dvc", "o.y4m", "--punctured", "p.dvc") == 0
    assert decode("p.dvc", "q.y4m", "--side-information", "depth") == 2
    assert "can only be decoded as it was made, with mci" in one_line_of(capsys)
    assert decode("s.dvc", "q.y4m", "--side-information", "depth") == 0


def test_json_goes_to_standard_output(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert decode("s.dvc", "o.y4m", "--json", "-") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["frames"] == 5
    assert report["psnr_y_db"] is None
    assert encode("clip.y4m", "o.dvc", "--json", "-") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["frames"] == 5
    assert report["config"]["codec"] == DEFAULT_CODEC == "3d-te"
    assert report["config"]["gop"].items() >= {"length": 16, "references": "hierarchical"}.items()


def test_messages_have_nothing_that_a_terminal_obeys(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A name with an escape or a line feed is shown in one line of printable characters."""
    assert decode("\x1b[31mno\nsuch\u202e.dvc", "o.y4m") == 2
    assert "?[31mno such?.dvc" in one_line_of(capsys)


def test_names_that_are_no_text_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    main = cli.command("x", lambda: cli.ArgumentParser("x", ""), lambda _: sys.stdout.write("\udcff") and 0)
    assert main([]) == 0
    assert capsys.readouterr().out == "\\udcff"


@pytest.mark.parametrize("module", ["encoder", "decoder"])
def test_help_is_quick_and_has_examples(module: str) -> None:
    code = (
        f"import sys, {module}.__main__ as m\n"
        "try: m.main(['--help'])\n"
        "except SystemExit: pass\n"
        "print('LOADED', *({'numpy', 'scipy', 'numba', 'cv2', 'av'} & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "examples:" in shown
    assert shown.splitlines()[-1] == "LOADED"


def test_version_tells_the_libraries(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        encoder.__main__.main(["--version"])
    text = capsys.readouterr().out
    assert not ended.value.code
    assert text.startswith(f"dvc-encode of dvc3d {dvc.__version__}; av ")
    assert f"numpy {np.__version__}" in text


def test_help_tells_the_defaults_of_the_variants(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")  # no word is broken
    with pytest.raises(SystemExit):
        encoder.__main__.main(["--help"])
    text = " ".join(capsys.readouterr().out.split())
    for name, variant in VARIANTS.items():
        assert f"{name}: {variant.summary}" in text
    assert f"default: {DEFAULT_CODEC}" in text
    assert "2 with 2d and 3d; 10 with 3d-td; 8 (16 with --key-frames intra) with 3d-te" in text
    assert "default: 64 (40 if only key frames are references)" in text


def test_expected_errors_become_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Errors of the project, the system and the keyboard end in one line and a status; bugs do not."""

    def fail(error: BaseException) -> int:
        raise error

    assert cli.run("x", lambda: 0) == 0
    errors = DvcError("two\nlines"), OSError(28, "No space left", "f"), OSError(28, "Full"), MemoryError()
    for error in errors:
        assert cli.run("x", lambda error=error: fail(error)) == 2
    assert cli.run("x", lambda: fail(KeyboardInterrupt())) == 130
    expected = "x: two lines\nx: f: No space left\nx: Full\nx: out of memory\nx: interrupted\n"
    assert capsys.readouterr().err == expected
    with pytest.raises(ZeroDivisionError):
        cli.run("x", lambda: fail(ZeroDivisionError()))


def test_check_outputs_accepts_what_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "in").touch()
    cli.check_outputs([tmp_path / "in"], [tmp_path / "a", tmp_path / "b"])
    (tmp_path / "link").symlink_to(tmp_path / "in")
    with pytest.raises(ConfigError, match="also an input"):
        cli.check_outputs([tmp_path / "in"], [tmp_path / "link"])


def test_files_in_folders_that_are_inputs_are_no_outputs(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "index.json").touch()
    (tmp_path / "link").symlink_to(tmp_path / "folder" / "index.json")
    inputs = cli.with_contents([tmp_path / "folder", tmp_path / "other.png"])
    cli.check_outputs(inputs, [tmp_path / "folder.json", tmp_path / "folder" / "new.json"])
    for name in ("folder/index.json", "link", "other.png"):
        with pytest.raises(ConfigError, match="also an input"):
            cli.check_outputs(inputs, [tmp_path / name])


def test_progress_bar_is_silent_away_from_terminals(capsys: pytest.CaptureFixture[str]) -> None:
    with cli.progress_bar("work", 2) as progress:
        progress(1)
        progress(1)
    assert capsys.readouterr().err == ""
