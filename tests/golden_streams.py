"""Frozen streams: how they are made; `python -m tests.golden_streams` makes those that are not there."""

import hashlib
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from benchmarks.results.live import serving
from dvc.geometry.cameras import PixelFrame
from dvc.video import Frame, create_video
from tests import frozen
from tests.clips import moving_texture, write_clip
from tests.scenes_3d import render

FOLDER = frozen.GOLDEN / "streams"


@dataclass(frozen=True)
class Golden:
    """How a frozen stream was made, and what has to serve its frames."""

    name: str
    size: tuple[int, int]
    num_frames: int
    coding: str
    method: str
    predicted_keys: bool = False  # whether some key frames are predicted
    uneven: bool = False  # frames come at a variable rate

    @property
    def forms(self) -> tuple[str, ...]:
        """Return the forms that it is frozen in."""
        if self.is_live:
            return ("punctured",)
        return ("no-feedback",) if "--no-feedback" in self.coding else ("buffered", "punctured")

    @property
    def is_live(self) -> bool:
        """Whether it is what a decoder took of an encoder, which told how much it may ask for."""
        return "--bitrate" in self.coding

    def path(self, form: str) -> Path:
        """Return where it lies."""
        return FOLDER / f"{self.name}-{form}.dvc"


def moving_texture_stream(name: str, size: tuple[int, int], num_frames: int, coding: str) -> Golden:
    """Return a stream of a texture that moves, predicted by block motion."""
    return Golden(f"2d-{name}", size, num_frames, f"--codec 2d {coding}", "mci")


def scene(name: str, size: tuple[int, int], coding: str, method: str = "depth") -> Golden:
    """Return a stream of four views of a static scene, predicted from its reconstruction."""
    return Golden(f"3d-{name}", size, 4, f"--codec 3d{coding}", method)


HIERARCHICAL = "--qp 28 --gop 8 --references hierarchical"
PREDICTED = "--codec 2d --qp 28 --gop 3 --key-frames predicted"
GOLDEN = [
    moving_texture_stream("colour", (48, 32), 5, "--wz-q 5"),
    moving_texture_stream("odd-luma", (45, 35), 5, "--wz-q 3 --gop 4 --luma-only"),
    moving_texture_stream("odd-colour", (51, 37), 3, "--wz-q 8 --noise-model frame"),
    moving_texture_stream("classical", (64, 48), 3, "--wz-q 6 --coder turbo"),
    moving_texture_stream("lossless-keys", (48, 32), 5, "--wz-q 4 --key-qp lossless"),
    moving_texture_stream("hierarchical", (48, 32), 9, "--wz-q 4 --gop 8 --references hierarchical"),
    moving_texture_stream("qp", (48, 32), 9, HIERARCHICAL),
    Golden("2d-predicted", (48, 32), 13, "--codec 2d --qp 30 --gop 4 --intra-period 8", "mci", True),
    Golden("2d-predicted-lossless", (45, 35), 7, f"{PREDICTED} --key-qp lossless", "mci", True),
    Golden("2d-time-stamps", (48, 32), 5, "--codec 2d --wz-q 4", "mci", uneven=True),
    Golden("2d-limited", (48, 32), 17, "--codec 2d --gop 4 --luma-only --bitrate 40k", "mci"),
    scene("colour", (104, 88), " --gop 3 --wz-q 5"),
    scene("td-luma", (104, 88), "-td --gop 3 --wz-q 6 --luma-only"),
    scene("td-all", (104, 88), "-td --gop 3 --references all --wz-q 1"),
    scene("te-colour", (104, 88), "-te --gop 3 --min-gop 3 --wz-q 4"),
    scene("te-odd", (105, 87), "-te --gop 3 --wz-q 5 --luma-only"),
    scene("te-classical", (104, 88), "-te --gop 3 --wz-q 4 --coder turbo"),
    scene("lossless", (128, 96), " --gop 3 --wz-q 3 --key-qp lossless --luma-only"),
    scene("te-lossless", (144, 96), "-te --gop 3 --wz-q 3 --key-qp lossless --luma-only"),
    scene("te-blocks", (104, 88), "-te --gop 3 --min-gop 3 --wz-q 4", "blocks"),
    scene("te-mesh", (104, 88), "-te --gop 3 --min-gop 3 --wz-q 4", "mesh"),
    scene("fused", (104, 88), " --gop 3 --wz-q 5", "fused"),
    scene("te-qp", (104, 88), "-te --gop 3 --min-gop 3 --qp 26 --key-frames intra"),
    Golden("3d-te-predicted", (104, 88), 7, "--codec 3d-te --gop 3 --qp 35 --intra-period 8", "depth", True),
    Golden(
        "3d-te",
        (104, 88),
        7,
        "--gop 6 --qp 18 --luma-only --intra-period 8 --no-feedback",
        "depth",
        True,
    ),
]


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
    if golden.uneven:
        with create_video(folder / "clip.mkv", golden.size, 25) as writer:
            for number, frame in enumerate(frames):
                writer.write(frame, Fraction(number * 40 + number**3, 1000))
        return folder / "clip.mkv"
    return write_clip(folder / "clip.y4m", frames)


def decode(golden: Golden, form: str, folder: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Decode a stream; return what is frozen of it, and the report of its Wyner-Ziv frames."""
    path = golden.path(form)
    video, punctured, report = (folder / name for name in ("video.y4m", "punctured.dvc", "report.json"))
    outputs = [video, "--json", report, "--side-information", golden.method]
    if form == "buffered":
        outputs += ["--punctured", punctured]
    assert decoder.main([str(path), *map(str, outputs), "--quiet"]) == 0
    found = json.loads(report.read_text())
    record = {
        "stream_sha256": digest(path),
        "video_sha256": digest(video),
        "num_frames": found["frames"],
        "num_requests": found["num_requests"],
        "parity_bits": found["bits"]["parity"],
    }
    if golden.uneven:
        record["times_s"] = [frame["time_s"] for frame in found["per_frame"]]
    return record, [frame for frame in found["per_frame"] if frame["type"] == "wz"]


def make(golden: Golden, folder: Path) -> dict[str, Any]:
    """Encode a clip, and decode it to see what is needed of the stream; return the records."""
    clip, form = source(golden, folder), golden.forms[0]
    options = golden.coding.split()
    if golden.is_live:
        with serving(clip, folder, options) as address:
            words = ["--connect", address, str(folder / "live.y4m"), "--punctured", str(golden.path(form))]
            assert decoder.main([*words, "--quiet"]) == 0
    else:
        assert encoder.main([str(clip), str(golden.path(form)), *options, "--quiet"]) == 0
    found = {golden.path(form).name: decode(golden, form, folder)[0]}
    for other in golden.forms[1:]:
        (folder / "punctured.dvc").rename(golden.path(other))
        found[golden.path(other).name] = decode(golden, other, folder)[0]
    return found


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Freeze the streams of the list that are not frozen yet."""
    wanted = [one for one in GOLDEN if frozen.missing(FOLDER, [one.path(form).name for form in one.forms])]
    for number, golden in enumerate(wanted, 1):
        sys.stderr.write(f"{number} of {len(wanted)}: {golden.name}\n")
        with tempfile.TemporaryDirectory() as folder:
            frozen.freeze(FOLDER, make(golden, Path(folder)))


if __name__ == "__main__":
    main()
