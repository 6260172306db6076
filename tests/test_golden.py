"""Frozen streams of every kind decode to the same frames for ever.

`DVC_REGENERATE=1` encodes them anew (only with a new format version, or to add one); a missing one fails.
"""

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from dvc.multiview.cameras import PixelFrame
from dvc.stream import StreamReader
from dvc.video import Frame
from tests.clips import moving_texture, write_clip
from tests.scenes_3d import render

FOLDER = Path(__file__).parent / "golden" / "streams"
RECORDS = FOLDER / "records.json"
MAX_BYTES = 100_000


@dataclass(frozen=True)
class Golden:
    """How a frozen stream was made, and what has to serve its frames."""

    name: str
    scene: bool  # views of a static scene, or else a texture that moves
    size: tuple[int, int]
    num_frames: int
    coding: str
    method: str


GOLDEN = [
    Golden("2d-colour", False, (48, 32), 5, "--codec 2d --wz-q 5", "mci"),
    Golden("2d-odd-luma", False, (45, 35), 5, "--codec 2d --wz-q 3 --gop 4 --luma-only", "mci"),
    Golden("2d-odd-colour", False, (51, 37), 3, "--codec 2d --wz-q 8 --noise-model frame", "mci"),
    Golden("2d-classical", False, (64, 48), 3, "--codec 2d --wz-q 6 --turbo classical", "mci"),
    Golden("2d-lossless-keys", False, (48, 32), 5, "--codec 2d --wz-q 4 --key-qp lossless", "mci"),
    Golden("2d-hierarchical", False, (48, 32), 9, "--codec 2d --gop 8 --references hierarchical", "mci"),
    Golden("3d-colour", True, (104, 88), 4, "--codec 3d --gop 3 --wz-q 5", "depth"),
    Golden("3d-td-luma", True, (104, 88), 4, "--codec 3d-td --gop 3 --wz-q 6 --luma-only", "depth"),
    Golden("3d-td-all", True, (104, 88), 4, "--codec 3d-td --gop 3 --references all --wz-q 1", "depth"),
    Golden("3d-te-colour", True, (104, 88), 4, "--codec 3d-te --gop 3 --min-gop 3 --wz-q 4", "depth"),
    Golden("3d-te-odd", True, (105, 87), 4, "--codec 3d-te --gop 3 --wz-q 5 --luma-only", "depth"),
    Golden("3d-te-classical", True, (104, 88), 4, "--codec 3d-te --gop 3 --turbo classical", "depth"),
    Golden(
        "3d-lossless",
        True,
        (128, 96),
        4,
        "--codec 3d --gop 3 --wz-q 3 --key-qp lossless --luma-only",
        "depth",
    ),
    Golden(
        "3d-te-lossless",
        True,
        (144, 96),
        4,
        "--codec 3d-te --gop 3 --wz-q 3 --key-qp lossless --luma-only",
        "depth",
    ),
    Golden("3d-te-blocks", True, (104, 88), 4, "--codec 3d-te --gop 3 --min-gop 3 --wz-q 4", "blocks"),
    Golden("3d-te-mesh", True, (104, 88), 4, "--codec 3d-te --gop 3 --min-gop 3 --wz-q 4", "mesh"),
    Golden("3d-fused", True, (104, 88), 4, "--codec 3d --gop 3 --wz-q 5", "fused"),
]
FORMS = ("buffered", "punctured")


def source(golden: Golden, folder: Path) -> Path:
    """Write the clip that a golden stream was made from."""
    width, height = golden.size
    if not golden.scene:
        frames: Sequence[Frame] = moving_texture(golden.num_frames, height, width)
    else:
        half = ((height + 1) // 2, (width + 1) // 2)
        chroma = np.full(half, 100, np.uint8), np.full(half, 150, np.uint8)
        times = np.arange(golden.num_frames) / (golden.num_frames - 1)
        frames = [Frame(render(time, PixelFrame(width, height))[0], chroma) for time in times]
    return write_clip(folder / "clip.y4m", frames)


def stream(golden: Golden, form: str) -> Path:
    """Return where a golden stream lies."""
    return FOLDER / f"{golden.name}-{form}.dvc"


def regenerate(golden: Golden, folder: Path) -> None:
    """Encode a clip, and decode it to see what is needed of the stream."""
    buffered, punctured = (stream(golden, form) for form in FORMS)
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


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def records() -> dict[str, Any]:
    """Return what is frozen of every stream."""
    found: dict[str, Any] = json.loads(RECORDS.read_text()) if RECORDS.exists() else {}
    return found


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden.name)
def test_golden_stream_decodes_to_the_frozen_frames(golden: Golden, form: str, tmp_path: Path) -> None:
    """The frames, requests and parity of each frozen stream are those of the day it was made."""
    path = stream(golden, form)
    if os.environ.get("DVC_REGENERATE") == "1":
        if form == "buffered":
            regenerate(golden, tmp_path)
        kept = records()
        kept[path.name] = decode(golden, path, tmp_path)[0]
        RECORDS.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
    assert path.stat().st_size <= MAX_BYTES
    record, frames = decode(golden, path, tmp_path)
    assert record == records()[path.name]
    served = {(frame["side_information"], frame["side_information_reason"]) for frame in frames}
    assert served == {(golden.method, "")}
    assert {frame["num_failed_planes"] for frame in frames} == {0}


def test_every_frozen_stream_is_listed() -> None:
    """No stream lies in the folder, and no record in the list, that nothing decodes."""
    names = {stream(golden, form).name for golden in GOLDEN for form in FORMS}
    assert {path.name for path in FOLDER.glob("*.dvc")} == set(records()) == names


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden.name)
def test_frozen_streams_name_the_methods_of_today(golden: Golden) -> None:
    """Dense depth, which format version 1 calls `mesh`, serves its streams by themselves as well."""
    preset = "depth" if golden.scene else "mci"
    for form, method in zip(FORMS, (preset, golden.method), strict=True):
        with StreamReader(stream(golden, form)) as reader:
            assert reader.config.side_information.method == method
