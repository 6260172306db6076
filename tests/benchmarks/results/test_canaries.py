"""Canaries of results."""

from pathlib import Path

from benchmarks.results.canaries import CANARIES
from benchmarks.results.rows import ROWS


def test_all_rows_name_canaries() -> None:
    """Every result depends on a configuration that there is, and every configuration serves one."""
    assert {name for row in ROWS for name in row.canaries} == set(CANARIES)


def test_canaries_repeat(tmp_path: Path) -> None:
    found = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        found.append(CANARIES["depth-map"](tmp_path / name))
    assert found[0] == found[1]
