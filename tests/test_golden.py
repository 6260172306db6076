"""Frozen streams of every kind decode to the same frames for ever, on any processor.

`DVC_REGENERATE=1` makes those of the present format version anew (to add one, or with a new version); a
missing one fails.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from dvc.environment import SINGLE_THREADED
from dvc.multiview.cameras import PixelFrame
from dvc.stream import StreamReader, StreamWriter
from dvc.stream.records import FORMAT_VERSION
from dvc.video import Frame
from tests.clips import moving_texture, write_clip
from tests.scenes_3d import render

FOLDER = Path(__file__).parent / "golden" / "streams"
RECORDS = FOLDER / "records.json"
MAX_BYTES = 100_000
FORMS = ("buffered", "punctured")


@dataclass(frozen=True)
class Golden:
    """How a frozen stream was made, and what has to serve its frames."""

    name: str
    size: tuple[int, int]
    num_frames: int
    coding: str
    method: str
    has_anchors: bool = False

    def path(self, version: int, form: str) -> Path:
        """Return where it lies."""
        return FOLDER / f"version_{version}" / f"{self.name}-{form}.dvc"


def moving_texture_stream(name: str, size: tuple[int, int], num_frames: int, coding: str) -> Golden:
    """Return a stream of a texture that moves, predicted by block motion."""
    return Golden(f"2d-{name}", size, num_frames, f"--codec 2d {coding}", "mci")


def scene(name: str, size: tuple[int, int], coding: str, method: str = "depth") -> Golden:
    """Return a stream of four views of a static scene, predicted from its reconstruction."""
    return Golden(f"3d-{name}", size, 4, f"--codec 3d{coding}", method)


GOLDEN = [
    moving_texture_stream("colour", (48, 32), 5, "--wz-q 5"),
    moving_texture_stream("odd-luma", (45, 35), 5, "--wz-q 3 --gop 4 --luma-only"),
    moving_texture_stream("odd-colour", (51, 37), 3, "--wz-q 8 --noise-model frame"),
    moving_texture_stream("classical", (64, 48), 3, "--wz-q 6 --turbo classical"),
    moving_texture_stream("lossless-keys", (48, 32), 5, "--wz-q 4 --key-qp lossless"),
    moving_texture_stream("hierarchical", (48, 32), 9, "--wz-q 4 --gop 8 --references hierarchical"),
    scene("colour", (104, 88), " --gop 3 --wz-q 5"),
    scene("td-luma", (104, 88), "-td --gop 3 --wz-q 6 --luma-only"),
    scene("td-all", (104, 88), "-td --gop 3 --references all --wz-q 1"),
    scene("te-colour", (104, 88), "-te --gop 3 --min-gop 3 --wz-q 4"),
    scene("te-odd", (105, 87), "-te --gop 3 --wz-q 5 --luma-only"),
    scene("te-classical", (104, 88), "-te --gop 3 --wz-q 4 --turbo classical"),
    scene("lossless", (128, 96), " --gop 3 --wz-q 3 --key-qp lossless --luma-only"),
    scene("te-lossless", (144, 96), "-te --gop 3 --wz-q 3 --key-qp lossless --luma-only"),
    scene("te-blocks", (104, 88), "-te --gop 3 --min-gop 3 --wz-q 4", "blocks"),
    scene("te-mesh", (104, 88), "-te --gop 3 --min-gop 3 --wz-q 4", "mesh"),
    scene("fused", (104, 88), " --gop 3 --wz-q 5", "fused"),
    scene("rigid-order", (104, 88), " --gop 3 --wz-q 5"),
    scene("td-rigid-order", (104, 88), "-td --gop 3 --wz-q 6 --luma-only"),
    scene("te-rigid-order", (105, 87), "-te --gop 3 --min-gop 3 --wz-q 4"),
    scene("td-both-depths", (104, 88), "-td --gop 3 --references all --wz-q 6 --luma-only"),
    moving_texture_stream("allocated", (48, 32), 9, "--qp 28 --gop 8 --references hierarchical"),
    scene("te-allocated", (104, 88), "-te --gop 3 --min-gop 3 --qp 26"),
    moving_texture_stream("learned", (48, 32), 9, "--qp 28 --gop 8 --references hierarchical"),
    scene("te-learned", (104, 88), "-te --gop 3 --min-gop 3 --qp 26 --intra-period 1"),
    moving_texture_stream("by-level", (48, 32), 9, "--qp 28 --gop 8 --references hierarchical"),
    moving_texture_stream(
        "long-delay", (48, 32), 9, "--qp 28 --gop 8 --references hierarchical --long-delay"
    ),
    Golden("3d-te-anchors", (104, 88), 7, "--codec 3d-te --gop 3 --qp 35 --intra-period 8", "depth", True),
]
ALL_PROCESSORS = os.environ.get("DVC_ALL_PROCESSORS") == "1"
"""Whether all frozen streams are decoded on every processor, as in continuous integration, or one a codec."""
_OF_EACH_CODEC = ("2d-colour", "3d-fused", "3d-td-all", "3d-te-odd")
CARRIED = [golden for golden in GOLDEN if ALL_PROCESSORS or golden.name in _OF_EACH_CODEC]
PROCESSORS = {
    "without-avx2": {
        "OPENBLAS_CORETYPE": "Sandybridge",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3",
        "OPENCV_CPU_DISABLE": "AVX2,FMA3",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA",
        "NUMBA_CPU_NAME": "generic",
        **SINGLE_THREADED,
    },
    "two-threads": {"OPENBLAS_CORETYPE": "Haswell", **dict.fromkeys(SINGLE_THREADED, "2")},
}
"""What makes libraries believe that they run on another processor than this one."""
OF_VERSION_1 = [golden for golden in GOLDEN if golden.path(1, FORMS[0]).exists()]


def source(golden: Golden, folder: Path) -> Path:
    """Write the clip that a golden stream was made from."""
    width, height = golden.size
    if golden.method == "mci":
        frames: Sequence[Frame] = moving_texture(golden.num_frames, height, width)
    else:
        half = ((height + 1) // 2, (width + 1) // 2)
        chroma = np.full(half, 100, np.uint8), np.full(half, 150, np.uint8)
        times = np.arange(golden.num_frames) / (golden.num_frames - 1)
        frames = [Frame(render(time, PixelFrame(width, height))[0], chroma) for time in times]
    return write_clip(folder / "clip.y4m", frames)


def regenerate(golden: Golden, folder: Path) -> None:
    """Encode a clip, and decode it to see what is needed of the stream."""
    buffered, punctured = (golden.path(FORMAT_VERSION, form) for form in FORMS)
    clip = source(golden, folder)
    assert encoder.main([str(clip), str(buffered), *golden.coding.split(), "--quiet"]) == 0
    decode(golden, buffered, folder)
    (folder / "punctured.dvc").rename(punctured)


def decode(golden: Golden, path: Path, folder: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Decode a stream; return what is frozen of it, and the report of its Wyner-Ziv frames."""
    video, punctured, report = (folder / name for name in ("video.y4m", "punctured.dvc", "report.json"))
    outputs = [video, "--punctured", punctured, "--json", report, "--side-information", golden.method]
    assert decoder.main([str(path), *map(str, outputs), "--quiet"]) == 0
    found = json.loads(report.read_text())
    record = {
        "stream_sha256": digest(path),
        "video_sha256": digest(video),
        "num_frames": found["frames"],
        "num_requests": found["num_requests"],
        "parity_bits": found["bits"]["parity"],
    }
    return record, [frame for frame in found["per_frame"] if frame["type"] == "wz"]


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
        files = [str(golden.path(FORMAT_VERSION, form)), str(video)]
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


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def records() -> dict[str, Any]:
    """Return what is frozen of every stream."""
    found: dict[str, Any] = json.loads(RECORDS.read_text())
    return found


def name_of(path: Path) -> str:
    """Return the name by which a stream is recorded."""
    return path.relative_to(FOLDER).as_posix()


def check(golden: Golden, path: Path, folder: Path) -> None:
    """Check that a stream decodes to what is frozen, and by the method that was meant."""
    record, frames = decode(golden, path, folder)
    assert record == records()[name_of(path)]
    served = {(frame["side_information"], frame["side_information_reason"]) for frame in frames}
    assert served == {(golden.method, "")} | ({("anchor", "")} if golden.has_anchors else set())
    assert {frame["num_failed_planes"] for frame in frames} == {0}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden.name)
def test_golden_stream_decodes_to_the_frozen_frames(golden: Golden, form: str, tmp_path: Path) -> None:
    """The frames, requests and parity of each frozen stream are those of the day it was made."""
    path = golden.path(FORMAT_VERSION, form)
    if os.environ.get("DVC_REGENERATE") == "1":
        if form == "buffered":
            regenerate(golden, tmp_path)
        kept = records() | {name_of(path): decode(golden, path, tmp_path)[0]}
        RECORDS.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
    assert path.stat().st_size <= MAX_BYTES
    check(golden, path, tmp_path)


@pytest.mark.parametrize("emulated", PROCESSORS, indirect=True)
@pytest.mark.parametrize("golden", CARRIED, ids=lambda golden: golden.name)
def test_golden_streams_decode_alike_on_every_processor(
    golden: Golden, emulated: Emulated, tmp_path: Path
) -> None:
    """Whatever libraries find, and with any number of threads, the frames are the frozen ones."""
    for form in FORMS if ALL_PROCESSORS else FORMS[1:]:
        found = emulated.video_digest(golden, form, tmp_path)
        assert found == records()[name_of(golden.path(FORMAT_VERSION, form))]["video_sha256"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("golden", OF_VERSION_1, ids=lambda golden: golden.name)
def test_version_1_decodes_or_is_refused_by_name(
    golden: Golden, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Old streams decode, but for punctured ones that hold for the processor which made them."""
    path = golden.path(1, form)
    if golden.method == "mci" or form == "buffered":
        check(golden, path, tmp_path)
    else:
        assert decoder.main([str(path), str(tmp_path / "video.y4m"), "--quiet"]) == 2
        assert "format version 1" in capsys.readouterr().err


def test_every_frozen_stream_is_listed() -> None:
    """No stream lies in the folder, and no record in the list, that nothing decodes."""
    present = {golden.path(FORMAT_VERSION, form) for golden in GOLDEN for form in FORMS}
    old = {golden.path(1, form) for golden in OF_VERSION_1 for form in FORMS}
    refused = {golden.path(1, "punctured") for golden in OF_VERSION_1 if golden.method != "mci"}
    assert set(FOLDER.rglob("*.dvc")) == present | old
    assert set(records()) == {name_of(path) for path in (present | old) - refused}


@pytest.mark.parametrize("golden", OF_VERSION_1, ids=lambda golden: golden.name)
def test_version_1_names_the_methods_of_today(golden: Golden) -> None:
    """Dense depth, which format version 1 calls `mesh`, serves its streams."""
    for form in FORMS:
        with StreamReader(golden.path(1, form)) as reader:
            assert reader.config.side_information.method == golden.method


def records_of(path: Path) -> list[tuple[int, int]]:
    """Return offset and size of each record of a stream: configuration, groups of pictures, end."""
    with StreamReader(path) as reader:
        entries = reader.index.entries
    first, end = entries[0].offset, entries[-1].offset + entries[-1].size
    groups = [(entry.offset, entry.size) for entry in entries]
    return [(5, first - 5), *groups, (end, path.stat().st_size - end)]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("golden", CARRIED, ids=lambda golden: golden.name)
def test_a_flipped_bit_is_named_with_its_record(
    golden: Golden, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One bit of any record, and the answer is one line with the number of the record."""
    data = golden.path(FORMAT_VERSION, form).read_bytes()
    for number, (offset, size) in enumerate(records_of(golden.path(FORMAT_VERSION, form))):
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
    """A newer format is not guessed at."""
    data = bytearray(GOLDEN[0].path(FORMAT_VERSION, "punctured").read_bytes())
    data[4] = FORMAT_VERSION + 1
    (tmp_path / "future.dvc").write_bytes(data)
    assert decoder.main([str(tmp_path / "future.dvc"), str(tmp_path / "video.y4m"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"format version {FORMAT_VERSION + 1}" in line


@pytest.mark.parametrize("golden", CARRIED, ids=lambda golden: golden.name)
def test_another_digest_is_said(golden: Golden, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A punctured stream whose digest is not that of the decoded frames says which group, and why."""
    with StreamReader(golden.path(FORMAT_VERSION, "punctured")) as reader:
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
