"""What the encoder makes of small clips, and what is decoded of it, stays the same to the byte.

Frozen streams hold for the decoder; these hold for decisions of the encoder, with the x264 of one version of
PyAV (`docs/constraints.txt`). `DVC_REGENERATE=1` stores what is found anew, where a change is meant.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
import sfm.__main__ as sfm
from dvc.geometry.cameras import PixelFrame
from dvc.video import Frame
from tests.clips import moving_texture, write_clip
from tests.scenes_3d import render

FOLDER = Path(__file__).parent / "golden" / "canaries"
RECORDS = FOLDER / "records.json"


class Canary(NamedTuple):
    """A clip, and how it is coded."""

    clip: str
    coding: str

    @property
    def name(self) -> str:
        """Return by what it is recorded."""
        return f"{self.clip} {self.coding}"


def wall() -> list[Frame]:
    """Return a board before a slanted wall, of which more and more comes into view."""
    return [Frame(render(time, PixelFrame(104, 88))[0]) for time in np.linspace(0.0, 1.6, 11)]


def jolt() -> list[Frame]:
    """Return a texture under the noise of a sensor, which moves faster from the middle on."""
    slow, fast = moving_texture(5, 80, 96, (0.25, 0.5)), moving_texture(5, 80, 96, (1.0, 3.0))
    rng = np.random.default_rng(5)
    noisy = (frame.luma + rng.normal(0.0, 2.0, frame.luma.shape) for frame in (*slow, *fast[1:]))
    return [Frame(np.clip(np.round(luma), 0, 255).astype(np.uint8)) for luma in noisy]


MADE: dict[str, Callable[[], Sequence[Frame]]] = {
    "wall": wall,
    "jolt": jolt,
    "pan": lambda: moving_texture(9, 96, 80, (0.5, 1.5)),
}
"""Clips that cost little to make; the others are stored, 128x96 samples of the rendered scenes."""
CODINGS = {
    "street": "--qp 30 --gop 4",
    "stairway": "--qp 26 --gop 4 --luma-only",
    "statue": "--qp 36 --gop 8 --luma-only",
    "wall": "--qp 28 --gop 5 --luma-only",
    "jolt": "--qp 32 --gop 4 --luma-only",
    "pan": "--qp 24",
}
"""Of the clips: the default codec at several qualities."""
CANARIES = [
    *(Canary(clip, coding) for clip, coding in CODINGS.items()),
    *(Canary(clip, f"{coding} --no-feedback") for clip, coding in CODINGS.items()),
    Canary("pan", "--codec 2d --wz-q 5 --luma-only"),
    Canary("wall", "--codec 3d --gop 5 --qp 30 --luma-only"),
    Canary("wall", "--codec 3d-td --gop 5 --qp 30 --luma-only"),
]
MAP = "wall map"


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that finds a clip, or makes it."""
    folder = tmp_path_factory.mktemp("clips")

    def find(name: str) -> Path:
        if name not in MADE:
            return FOLDER / f"{name}.mkv"
        path = folder / f"{name}.y4m"
        return path if path.exists() else write_clip(path, MADE[name]())

    return find


def decoded(folder: Path, clip: Path, *source: object) -> dict[str, Any]:
    """Decode; return bytes and PSNR, which frames are key frames, and a digest of all frames."""
    outputs = [folder / "video.y4m", "--json", folder / "report.json", "--reference", clip, "--quiet"]
    assert decoder.main([*map(str, source), *map(str, outputs)]) == 0
    report = json.loads((folder / "report.json").read_text())
    return {
        "bytes": report["stream_bytes"],
        "psnr_y_db": round(report["psnr_y_db"], 4),
        "types": "".join(frame["type"][0] for frame in report["per_frame"]),
        "video": digest(folder / "video.y4m"),
    }


def digest(*paths: Path) -> str:
    """Return a digest of files."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


def stored() -> dict[str, Any]:
    """Return what was found of each canary."""
    found: dict[str, Any] = json.loads(RECORDS.read_text()) if RECORDS.exists() else {}
    return found


def names() -> list[str]:
    """List what is stored."""
    return [*(canary.name for canary in CANARIES), MAP]


def store(name: str, found: dict[str, Any]) -> None:
    """Store what was found, if that is asked for."""
    if os.environ.get("DVC_REGENERATE") == "1":
        kept = stored() | {name: found}
        RECORDS.write_text(json.dumps({one: kept[one] for one in names() if one in kept}, indent=1) + "\n")


@pytest.mark.parametrize("canary", CANARIES, ids=lambda canary: canary.name)
def test_bytes_and_psnr_are_as_before(canary: Canary, clips: Callable[[str], Path], tmp_path: Path) -> None:
    """Of what the decoder needs of a parity buffer, and of streams that nobody asks for more."""
    clip, stream, needed = clips(canary.clip), tmp_path / "stream.dvc", tmp_path / "needed.dvc"
    assert encoder.main([str(clip), str(stream), *canary.coding.split(), "--quiet"]) == 0
    alone = "--no-feedback" in canary.coding
    found = decoded(tmp_path, clip, stream, *([] if alone else ["--punctured", needed]))
    assert found["bytes"] == (stream if alone else needed).stat().st_size
    found["streams"] = digest(stream, *([] if alone else [needed]))
    store(canary.name, found)
    assert found == stored()[canary.name]


def test_live_runs_cost_the_same(clips: Callable[[str], Path], tmp_path: Path) -> None:
    clip = clips("jolt")
    command = [sys.executable, "-m", "encoder", clip, *CODINGS["jolt"].split(), "--serve", "127.0.0.1:0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        port = int(process.stderr.readline().rsplit(":", 1)[1])
        found = decoded(tmp_path, clip, "--connect", f"127.0.0.1:{port}")
        process.communicate(timeout=60)
    assert process.returncode == 0
    assert found.items() <= stored()[CANARIES[list(CODINGS).index("jolt")].name].items()


def test_a_map_is_as_before(clips: Callable[[str], Path], tmp_path: Path) -> None:
    assert sfm.main([str(clips("wall")), "--out", str(tmp_path / "map"), "--quiet"]) == 0
    piece = json.loads((tmp_path / "map" / "scene.json").read_text())["pieces"][0]
    found = {
        "frames": piece["frames"],
        "depth_frames": piece["depth_frames"],
        "num_points": piece["num_points"],
        "matrix": json.loads((tmp_path / "map" / "intrinsics.json").read_text())["matrix"],
        "centres": np.loadtxt(tmp_path / "map" / "trajectory.txt")[:, 1:4].round(6).tolist(),
    }
    store(MAP, found)
    expected = stored()[MAP]
    assert [found[key] for key in ("frames", "depth_frames")] == [
        expected["frames"],
        expected["depth_frames"],
    ]
    assert found["num_points"] == pytest.approx(expected["num_points"], rel=0.005)
    np.testing.assert_allclose(found["matrix"], expected["matrix"], rtol=1e-3)
    np.testing.assert_allclose(
        found["centres"], expected["centres"], atol=1e-3 * np.abs(found["centres"]).max()
    )


def test_nothing_else_is_stored() -> None:
    assert list(stored()) == names()
    assert {path.stem for path in FOLDER.glob("*.mkv")} == set(CODINGS) - set(MADE)
