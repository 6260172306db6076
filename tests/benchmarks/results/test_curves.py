"""Sweeps of results: which are in colour, and BD-rates by luma and in colour."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.results import curves
from benchmarks.results.harness import Setting
from benchmarks.results.rows import BY_NAME
from dvc.rd.rd_results import POINTS_FOLDER
from tests.rd.made_up import result_data, write_colour_results

Commands = list[tuple[str, tuple[str, ...]]]


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> Iterator[Commands]:
    """Note sweeps instead of measuring them."""
    found: Commands = []

    def _note(_: Setting, clips: list[str], name: str, *options: str, num_frames: int) -> None:
        del clips, num_frames
        found.append((name, options))

    monkeypatch.setattr(curves, "run_sweep", _note)
    monkeypatch.setattr(curves, "frames", lambda _: 3)
    monkeypatch.setattr(Setting, "clips", lambda *_: ["clip"])
    curves.sweep.cache_clear()
    yield found
    curves.sweep.cache_clear()


def test_anchors_are_compared_by_luma_and_in_colour(commands: Commands, tmp_path: Path) -> None:
    folder = write_colour_results(tmp_path / curves.DEFAULT)
    for number, rate_kbps in enumerate((6.0, 24.0)):
        data = result_data(rate_kbps, 29.0 + 6.0 * number)
        (folder / POINTS_FOLDER / f"luma-{number}.json").write_text(json.dumps(data), encoding="utf-8")
    setting = Setting(folder=tmp_path)
    assert curves.against_anchor(setting, "intra").value == pytest.approx(-20.0)
    assert curves.against_anchor(setting, "intra", measure="colour").value == pytest.approx(0.0, abs=1e-6)
    assert not any("--luma-only" in options for _, options in commands)


def test_what_exists_for_luma_only_is_compared_so(
    commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(curves, "curves_in", lambda *_: {})
    monkeypatch.setattr(curves, "mean_of", lambda *_: None)
    BY_NAME["rate/matrices"].measure(Setting(folder=tmp_path))
    assert len(commands) == 2
    assert all("--luma-only" in options for _, options in commands)
