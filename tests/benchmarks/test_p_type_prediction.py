"""Predictions of P-type frames: block motion finds what there is to find, and a run prints a row."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import p_type_prediction
from benchmarks.p_type_prediction import Row, block_motion, table
from dvc.metrics import psnr_db
from sequences.sequence import RenderedSequence
from tests.clips import moving_texture, write_clip

STILL = np.zeros((6, 9, 2), np.int64)
"""Where a search starts, in a frame of 72x48."""


def test_block_motion_finds_large_shifts_exactly() -> None:
    """Where the reference has the block, as far as the search goes."""
    texture = moving_texture(1, 150, 170)[0].luma
    original, reference = texture[40:88, 50:122], texture[21:69, 90:162]
    assert np.array_equal(block_motion(original, [reference], [STILL])[:24, 40:], original[:24, 40:])


def test_block_motion_starts_where_it_is_told() -> None:
    """What is farther than it searches is found near the start."""
    texture = moving_texture(1, 120, 170)[0].luma
    original, reference = texture[30:78, 70:142], texture[30:78, 18:90]
    near = STILL + 4 * np.array([2, 48])
    assert np.array_equal(block_motion(original, [reference], [near])[:, :16], original[:, :16])
    assert not np.array_equal(block_motion(original, [reference], [STILL])[:, :16], original[:, :16])


def test_block_motion_finds_quarter_samples() -> None:
    """Only rounding and interpolation are left."""
    before, wanted = (frame.luma for frame in moving_texture(2, 47, 71, motion_px=(-2.75, 3.5)))
    found = block_motion(wanted, [before], [STILL])
    assert found.shape == wanted.shape
    assert psnr_db(found[:40, 8:], wanted[:40, 8:]) > 45.0


def test_block_motion_takes_the_better_reference() -> None:
    """Each block has one of its own."""
    frame = moving_texture(1, 48, 72)[0].luma
    left, right = frame.copy(), frame.copy()
    left[:, 40:], right[:, :40] = 0, 255
    assert np.array_equal(block_motion(frame, [left, right], [STILL, STILL]), frame)


def test_table_has_a_row_a_clip_and_their_mean() -> None:
    """Clips weigh the same, and those without P-type frames nothing."""
    found = {
        "a": {8: Row(30.0, 30.0, 33.0, 34.0), 16: Row(32.0, 34.0, 35.0, 36.0)},
        "b": {},
        "c": {8: Row(21.0, 25.0, 27.0, 29.0)},
    }
    lines = [line.split() for line in table(found).splitlines()]
    assert lines[1] == ["a", "2", "1", "31.00", "32.00", "34.00", "35.00", "25", "%"]
    assert lines[2] == ["b", "none"]
    assert lines[4] == ["mean", "3", "2", "26.00", "28.50", "30.50", "32.00", "42", "%"]
    assert table({"b": {}}).splitlines()[1:] == ["b              none"]


def test_a_run_tells_of_all_p_type_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without key frames there are some, and block motion with the original predicts them best."""
    frames = list(RenderedSequence("street", 96, 80, num_frames=9))
    clip, told = write_clip(tmp_path / "clip.mkv", frames), tmp_path / "told.json"
    words = [str(clip), "--frames", "9", "--qp", "36", "--all-p-type", "--json", str(told)]
    assert p_type_prediction.main(words) == 0
    (rows,) = json.loads(told.read_text(encoding="utf-8")).values()
    assert list(rows) == ["8"]
    assert rows["8"]["by_tracks"] == rows["8"]["used"] < rows["8"]["block_motion"]
    assert capsys.readouterr().out.splitlines()[-1].startswith("mean              1        0 ")
