"""Long recordings: killed at any moment, in as much memory as short ones, and begun at once."""

import gc
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from itertools import cycle, islice
from pathlib import Path

import pytest

import decoder.__main__
import encoder.__main__
from dvc.errors import BitstreamError
from dvc.stream import GopRecord, StreamReader
from dvc.video import Frame, VideoInfo
from encoder import encoder_options as options
from encoder.__main__ import new_session
from tests.clips import moving_texture, raw_bytes

SIZE = (48, 32)
NUM_FRAMES = 200
RAW = ("--size", f"{SIZE[0]}x{SIZE[1]}", "--frame-rate", "25")
CODING = (*RAW, "--gop", "4", "--intra-period", "12", "--luma-only", "--quiet")
FORMS = {"no-feedback": ("--no-feedback",), "segments": ("--segment", "2")}

# Encodes a little, so that all is loaded; then starts the encoder in forks, one after the other, and kills
# each of them a little after it has written so many bytes.
_KILLER = """
import os, signal, sys, time
import cv2
import encoder.__main__
cv2.setNumThreads(0)  # forks have no other threads
def size(folder):
    try:
        return sum(entry.stat().st_size for entry in os.scandir(folder))
    except FileNotFoundError:  # it got its final name in between
        return 0
moments, arguments = eval(sys.argv[1]), sys.argv[2:]
assert encoder.__main__.main([*arguments, "--frames", "9"]) == 0
for number, (num_bytes, later_s) in enumerate(moments):
    child = os.fork()
    if child == 0:
        os.chdir(str(number))
        os._exit(encoder.__main__.main(arguments))
    while size(str(number)) < num_bytes:
        time.sleep(0.0005)
    time.sleep(later_s)
    os.kill(child, signal.SIGKILL)
    print(os.waitpid(child, 0)[1])
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write many frames as they come from a camera."""
    frames = moving_texture(24, SIZE[1], SIZE[0])
    path = tmp_path_factory.mktemp("input") / "long.yuv"
    path.write_bytes(raw_bytes(islice(cycle([*frames, *frames[::-1]]), NUM_FRAMES)))
    return path


@pytest.fixture(scope="module", params=FORMS)
def undisturbed(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, recording: Path
) -> tuple[tuple[str, ...], list[bytes]]:
    """Encode all of them; return the options, and the streams that come of it."""
    folder = tmp_path_factory.mktemp(str(request.param))
    options = (*CODING, *FORMS[request.param])
    assert encoder.__main__.main([str(recording), str(folder / "day.dvc"), *options]) == 0
    return options, [path.read_bytes() for path in sorted(folder.iterdir())]


def finished_groups(path: Path) -> tuple[list[GopRecord], str | None]:
    """Read the groups of pictures that are finished, and what is missing."""
    try:
        with StreamReader(path, unfinished=True) as reader:
            return list(reader), reader.missing
    except BitstreamError:
        return [], None


def killed(
    folder: Path, recording: Path, options: tuple[str, ...], moments: list[tuple[int, float]]
) -> list[list[Path]]:
    """Kill an encoder at each of some moments; return the files that it left each time, in order."""
    folders = [folder / str(number) for number in range(len(moments))]
    for each in folders:
        each.mkdir()
    command = [sys.executable, "-c", _KILLER, repr(moments), str(recording), "day.dvc", *options]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    ended = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=True, env=environment, timeout=120
    )
    assert len(ended.stdout.split()) == len(moments)
    return [sorted(each.iterdir()) for each in folders]


def check_remains(left: list[Path], whole: list[bytes]) -> tuple[int, str | None]:
    """Check that what a killed encoder left is the beginning of all; count finished groups, name the rest."""
    count, missing = 0, None
    assert len(left) <= len(whole)
    for path, expected in zip(left, whole, strict=False):
        assert expected.startswith(path.read_bytes())
        groups, missing = finished_groups(path)
        count += len(groups)
        assert path.suffix == ".part" or path.read_bytes() == expected
    return count, missing


@pytest.mark.parametrize("num_kills", [10, pytest.param(40, marks=pytest.mark.slow)])
def test_kill_at_random_moments_loses_no_finished_group(
    tmp_path: Path, recording: Path, undisturbed: tuple[tuple[str, ...], list[bytes]], num_kills: int
) -> None:
    """What is left of a recording is the beginning of an undisturbed one; the rest is named."""
    options, whole = undisturbed
    draw = random.Random(num_kills)
    total = sum(map(len, whole))
    moments = [(draw.randrange(int(0.9 * total)), draw.uniform(0.0, 0.01)) for _ in range(num_kills)]
    found = killed(tmp_path, recording, options, moments)
    counts = [check_remains(left, whole) for left in found]
    assert len({count for count, _ in counts}) > num_kills // 3
    cut = min(
        (left[-1] for left, (_, missing) in zip(found, counts, strict=True) if missing),
        key=lambda path: path.stat().st_size,
    )
    video = tmp_path / "video.y4m"
    groups, _ = finished_groups(cut)
    assert decoder.__main__.main([str(cut), str(video), "--unfinished", "--quiet"]) == 0
    assert video.read_bytes().count(b"FRAME") == sum(group.num_frames for group in groups)


def resident_bytes() -> int:
    """Return how much memory this process has, after a collection."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("form", [("--no-feedback",), ()])
def test_memory_does_not_grow_with_the_recording(form: tuple[str, ...]) -> None:
    """After sixty groups the encoder has as much as after ten, or a tenth of the frames between more."""
    frames = moving_texture(24, 144, 176)
    arguments = options.parser().parse_args(["-", "long.dvc", "--gop", "4", "--luma-only", "--quiet", *form])
    found: list[int] = []

    def camera() -> Iterator[Frame]:
        for number, frame in enumerate(islice(cycle([*frames, *frames[::-1]]), 240)):
            if number in (40, 239):
                found.append(resident_bytes())
            yield Frame(frame.luma.copy())

    with open(os.devnull, "wb") as file:
        session = new_session(arguments, VideoInfo(176, 144, Fraction(25)))
        session.write(camera(), file, lambda _: None)
    assert found[1] - found[0] < 20 * frames[0].luma.size
