"""Frozen streams of every kind (`tests.golden_streams`) decode to the frozen frames, on any processor."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

import decoder.__main__ as decoder
from dvc.environment import SINGLE_THREADED
from dvc.stream import StreamReader, StreamWriter
from dvc.stream.records import FORMAT_VERSION
from tests import frozen
from tests.golden_streams import FOLDER, GOLDEN, Golden, decode, digest

MAX_BYTES = 100_000
STREAMS = [
    pytest.param(golden, form, id=f"{golden.name}-{form}") for golden in GOLDEN for form in golden.forms
]
ALL_PROCESSORS = os.environ.get("DVC_ALL_PROCESSORS") == "1"
"""Whether all frozen streams are decoded on every processor, or one a codec on one of them."""
_OF_EACH_CODEC = ("2d-colour", "3d-fused", "3d-td-all", "3d-te-odd")
CARRIED = [golden for golden in GOLDEN if ALL_PROCESSORS or golden.name in _OF_EACH_CODEC]
PROCESSORS = {
    "without-avx2": {
        "OPENBLAS_CORETYPE": "Sandybridge",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3",
        "OPENCV_CPU_DISABLE": "AVX2,FMA3",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA",
        **SINGLE_THREADED,
    },
    "generic": {"NUMBA_CPU_NAME": "generic", **SINGLE_THREADED},
    "two-threads": {"OPENBLAS_CORETYPE": "Haswell", **dict.fromkeys(SINGLE_THREADED, "2")},
}
"""What makes libraries believe that they run on another processor than this one."""


class Emulated:
    """A process that decodes as if on another processor."""

    def __init__(self, processor: dict[str, str]) -> None:
        command = [sys.executable, "-m", "tests.decoding_process"]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, env=os.environ | processor, stdin=pipe, stdout=pipe, text=True
        )

    def video_digest(self, golden: Golden, form: str, folder: Path) -> str:
        """Decode a stream; return the digest of the video."""
        video = folder / "emulated.y4m"
        files = [str(golden.path(form)), str(video)]
        arguments = [*files, "--quiet", "--side-information", golden.method]
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(arguments) + "\n")
        self._process.stdin.flush()
        answered, status, said = json.loads(self._process.stdout.readline())
        assert answered == arguments
        assert status == 0, said
        return digest(video)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


@pytest.fixture(scope="module")
def emulated(request: pytest.FixtureRequest) -> Iterator[Emulated]:
    """Return a process on the processor of this name, for all streams."""
    with closing(Emulated(PROCESSORS[request.param])) as process:
        yield process


@pytest.mark.parametrize(("golden", "form"), STREAMS)
def test_golden_stream_decodes_to_the_frozen_frames(golden: Golden, form: str, tmp_path: Path) -> None:
    """The frames, requests and parity of each frozen stream are those of the day it was made."""
    assert golden.path(form).stat().st_size <= MAX_BYTES
    record, frames = decode(golden, form, tmp_path)
    assert record == frozen.records(FOLDER)[golden.path(form).name]
    served = {(frame["side_information"], frame["side_information_reason"]) for frame in frames}
    expected = {(golden.method, "")}
    assert expected == served if form != "no-feedback" else expected <= served
    assert {frame["num_failed_planes"] for frame in frames} == {0}


@pytest.mark.parametrize("emulated", [*PROCESSORS][: None if ALL_PROCESSORS else 1], indirect=True)
@pytest.mark.parametrize("golden", CARRIED, ids=lambda golden: golden.name)
def test_golden_streams_decode_alike_on_every_processor(
    golden: Golden, emulated: Emulated, tmp_path: Path
) -> None:
    """Whatever libraries find, and with any number of threads, the frames are the frozen ones."""
    for form in golden.forms if ALL_PROCESSORS else golden.forms[-1:]:
        found = emulated.video_digest(golden, form, tmp_path)
        assert found == frozen.records(FOLDER)[golden.path(form).name]["video_sha256"]


def test_every_frozen_stream_is_listed() -> None:
    listed = {golden.path(form).name for golden in GOLDEN for form in golden.forms}
    assert {path.name for path in FOLDER.rglob("*.dvc")} == listed == set(frozen.records(FOLDER))


@pytest.mark.parametrize(("folder", "release"), frozen.DIGESTS)
def test_what_a_release_has_frozen_stays(folder: str, release: str) -> None:
    assert frozen.digest(frozen.GOLDEN / folder, release) == frozen.DIGESTS[folder, release]


@pytest.mark.parametrize("folder", ["streams", "dibr"])
def test_each_release_has_a_digest_of_what_it_has_frozen(folder: str) -> None:
    found = {path.stem.removeprefix("records-") for path in (frozen.GOLDEN / folder).glob("records-*.json")}
    assert found == {release for named, release in frozen.DIGESTS if named == folder}


def records_of(path: Path) -> list[tuple[int, int]]:
    """Return offset and size of each record of a stream: configuration, groups of pictures, end."""
    with StreamReader(path) as reader:
        entries = reader.index.entries
    first, end = entries[0].offset, entries[-1].offset + entries[-1].size
    groups = [(entry.offset, entry.size) for entry in entries]
    return [(5, first - 5), *groups, (end, path.stat().st_size - end)]


@pytest.mark.parametrize(("golden", "form"), [one for one in STREAMS if one.values[0] in CARRIED])
def test_a_flipped_bit_is_named_with_its_record(
    golden: Golden, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One bit of any record, and the answer is one line with the number of the record."""
    data = golden.path(form).read_bytes()
    for number, (offset, size) in enumerate(records_of(golden.path(form))):
        damaged = bytearray(data)
        damaged[offset + size // 2] ^= 4
        (tmp_path / "damaged.dvc").write_bytes(damaged)
        assert decoder.main([str(tmp_path / "damaged.dvc"), str(tmp_path / "video.y4m"), "--quiet"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"record {number} " in line
        assert not (tmp_path / "video.y4m").exists()


def test_a_stream_of_the_future_is_refused_by_its_version(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(GOLDEN[0].path("punctured").read_bytes())
    data[4] = FORMAT_VERSION + 1
    (tmp_path / "future.dvc").write_bytes(data)
    assert decoder.main([str(tmp_path / "future.dvc"), str(tmp_path / "video.y4m"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"format version {FORMAT_VERSION + 1}" in line


@pytest.mark.parametrize("golden", CARRIED, ids=lambda golden: golden.name)
def test_another_digest_is_said(golden: Golden, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A punctured stream whose digest is not that of the decoded frames says which group, and why."""
    with StreamReader(golden.path("punctured")) as reader:
        groups = list(reader)
        with (
            (tmp_path / "other.dvc").open("wb") as file,
            StreamWriter(file, reader.config, reader.form) as writer,
        ):
            for number, group in enumerate(groups):
                changed = None if group.digest is None else group.digest ^ (number == 1)
                writer.write_gop(replace(group, digest=changed))
    assert decoder.main([str(tmp_path / "other.dvc"), str(tmp_path / "video.y4m"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "group of pictures 1: the punctured stream was made for other predictions" in line
    assert "digest" in line
