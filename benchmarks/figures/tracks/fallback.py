"""Frames of which there is no model of the scene: what serves in its place, and beside it elsewhere.

One stream with one quality is decoded twice, with references brought into place by tracks, pixel by pixel,
and with block motion after alignment. Both decoders get what they ask for, so the frames that they predict
from differ a little as well, as they do for a receiver.
"""

import json
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting, clip_source, run_module
from benchmarks.figures.tracks.quality import AREA, QUICK_FRAMES
from dvc.config import FALLBACKS

QP = 30
CLIPS = ("river", "cube", "desk", "box")
LEAST_MEAN_DB = 2.0


class Gains(NamedTuple):
    """How much better frames are predicted, and what that does to the whole."""

    without_scene_db: tuple[float, ...]  # PSNR of the side information, new minus old, of each frame
    beside_scene_db: tuple[float, ...]
    rate_percent: float  # change of the bits that were needed, key frames and tracks included
    psnr_db: float  # change of the mean PSNR of the decoded frames


def measured_gains(setting: Setting, clip: str) -> Gains:
    """Decode a stream in both ways."""
    source = clip_source(clip).path
    frames = setting.choose(setting.frames, QUICK_FRAMES)
    with tempfile.TemporaryDirectory() as folder:
        stream = Path(folder, "a.dvc")
        coding = "--qp", QP, "--luma-only", "--frames", frames, "--quiet"
        run_module("encoder", [source, stream, *coding])
        old, new = (_decoded(stream, source, fallback) for fallback in FALLBACKS)
    pairs = [(a, b) for a, b in zip(old["per_frame"], new["per_frame"], strict=True) if a["type"] == "wz"]
    gained = [(b["si_psnr_y_db"] - a["si_psnr_y_db"], bool(a["side_information_reason"])) for a, b in pairs]
    return Gains(
        tuple(gain for gain, missing in gained if missing),
        tuple(gain for gain, missing in gained if not missing),
        100.0 * (new["stream_bytes"] / old["stream_bytes"] - 1.0),
        new["psnr_y_db"] - old["psnr_y_db"],
    )


def _decoded(stream: Path, source: Path, fallback: str) -> dict[str, Any]:
    """Decode a stream, and return the report."""
    video, report = stream.with_suffix(".y4m"), stream.with_suffix(".json")
    run_module(
        "decoder", [stream, video, "--fallback", fallback, "--reference", source, "--json", report, "--quiet"]
    )
    found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return found


def gains(setting: Setting, clip: str) -> Measured:
    """Compare the side information with and without warps by tracks."""
    found = measured_gains(setting, clip)
    values: dict[str, Any] = {"rate_percent": found.rate_percent, "psnr_db": found.psnr_db}
    texts = []
    for name, each in (("without", found.without_scene_db), ("beside", found.beside_scene_db)):
        values[f"num_{name}_scene"] = len(each)
        if each:
            mean, least = float(np.mean(each)), min(each)
            values |= {f"{name}_scene_db": mean, f"{name}_scene_least_db": least}
            texts.append(f"{name} scene {mean:+.2f} dB, least {least:+.2f} dB, of {len(each)} frames")
    texts.append(f"all bits {found.rate_percent:+.1f} %, decoded {found.psnr_db:+.2f} dB")
    missing = found.without_scene_db
    holds = bool(np.mean(missing) >= LEAST_MEAN_DB and min(missing) >= 0.0) if missing else None
    return Measured("; ".join(texts), holds, values)


FIGURES = (
    Figure(
        AREA,
        "fallback",
        f"PSNR of the side information, `3d-te --qp {QP}`, warped by tracks minus aligned block motion",
        "without a scene mean ≥ +2 dB, least ≥ 0",
        gains,
        CLIPS,
    ),
)
"""The figures of this module."""
