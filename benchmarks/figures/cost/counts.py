"""What the encoder counts itself: operations a pixel by its model, and memory without Python's share."""

import json
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.figures.allocation.curves import FRAMES
from benchmarks.figures.cost.rate_cost import AREA
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, clip_source, run_module
from benchmarks.figures.rates import QUICK_FRAMES
from dvc.config import DEFAULT_QP
from encoder.operations import Operations


def _report(setting: Setting, clip: str) -> dict[str, Any]:
    """Encode a clip in a process of its own, and return what it counted."""
    frames = setting.choose(FRAMES, QUICK_FRAMES)
    with tempfile.TemporaryDirectory() as scratch:
        stream, report = Path(scratch) / "s.dvc", Path(scratch) / "report.json"
        words = ["--no-feedback", "--luma-only", "--qp", DEFAULT_QP, "--frames", frames, "--quiet"]
        run_module("encoder", [clip_source(clip).path, stream, *words, "--json", report])
        found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return found


def operations(setting: Setting, clip: str) -> Measured:
    """Count operations a pixel by the model of the encoder, which tests hold against its kernels."""
    found = _report(setting, clip)["operations_per_pixel"]
    totals = {name: Operations(**stage).total for name, stage in found.items()}
    moved = sum(stage["bytes"] for stage in found.values())
    parts = ", ".join(f"{name} {total:.1f}" for name, total in totals.items())
    text = f"{sum(totals.values()):.1f} operations a pixel ({parts}), {moved:.0f} bytes"
    return Measured(text, None, {"operations_per_pixel": found})


def memory(setting: Setting, clip: str) -> Measured:
    """Tell how much memory the encoder's process takes at most beyond Python, libraries and loaded code."""
    found = _report(setting, clip)["memory"]
    text = f"{found['own_bytes'] / 1e6:.0f} MB of {found['peak_bytes'] / 1e6:.0f} MB"
    return Measured(text, None, dict(found), "the input is read in the same process")


_RUN = "49 frames, --no-feedback, QP 28"
FIGURES = (
    Figure(
        AREA,
        "operations",
        f"operations a pixel of the encoder but for key frames, {_RUN}",
        "the true figure",
        operations,
        STATIC_CLIPS,
        programs=("encoder",),
    ),
    Figure(
        AREA,
        "memory",
        f"peak memory of the encoder without Python's share, {_RUN}",
        "the true figure",
        memory,
        ("box",),
        programs=("encoder",),
    ),
)
"""The figures of this module."""
