"""What no prediction is made for, without a feedback channel: noise, cuts, and frames without any point."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from dvc.video import Frame
from tests.clips import moving_texture, write_clip

HEIGHT, WIDTH, NUM_FRAMES = 48, 64, 7


def _noise() -> list[Frame]:
    rng = np.random.default_rng(0)
    return [Frame(rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8)) for _ in range(NUM_FRAMES)]


def _cut() -> list[Frame]:
    scenes = [moving_texture(NUM_FRAMES, HEIGHT, WIDTH, seed=seed) for seed in (0, 1)]
    return [*scenes[0][:3], *scenes[1][3:]]


def _still() -> list[Frame]:
    return [Frame(np.full((HEIGHT, WIDTH), 128, np.uint8))] * NUM_FRAMES


@pytest.mark.parametrize("frames", [_noise, _cut, _still], ids=["noise", "cut", "flat"])
def test_any_input_decodes(tmp_path: Path, frames: Callable[[], list[Frame]]) -> None:
    """All frames come out, key frames as good as ever, others as predicted; the counts add up."""
    clip = write_clip(tmp_path / "clip.y4m", frames())
    stream, video, report = (tmp_path / name for name in ("s.dvc", "v.y4m", "r.json"))
    coding = ["--no-feedback", "--gop", "3", "--qp", "26", "--luma-only", "--quiet"]
    assert encoder.main([str(clip), str(stream), *coding]) == 0
    arguments = [str(stream), str(video), "--reference", str(clip), "--json", str(report), "--quiet"]
    assert decoder.main(arguments) == 0
    found = json.loads(report.read_text())
    rows = found["per_frame"]
    assert [row["index"] for row in rows] == list(range(NUM_FRAMES))
    assert video.read_bytes().count(b"FRAME") == NUM_FRAMES
    assert sum(found["bits"].values()) == 8 * stream.stat().st_size
    assert all(row["psnr_y_db"] > 28.0 for row in rows if row["type"] == "key")
    for row in rows:
        if row["type"] == "wz":
            assert row["psnr_y_db"] == pytest.approx(row["si_psnr_y_db"], abs=0.1)
