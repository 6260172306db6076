"""The measurement of what long-term references spare."""

import pytest

from benchmarks.closed_path import main


@pytest.mark.slow
def test_a_short_clip_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    """Both halves, with and without; all bits are somewhere."""
    assert main(["--frames", "4", "--size", "64x48"]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["long-term", "round", "kbit", "PSNR", "key", "frames"]
    values = [[float(value) for value in row.split()] for row in rows]
    assert [row[:2] for row in values] == [[0, 1], [0, 2], [64, 1], [64, 2]]
    assert all(row[2] >= 0 and row[3] > 25 for row in values)
    assert values[0][2:] == values[2][2:]
    assert values[0][4] >= 1
