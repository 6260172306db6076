"""Changes of the packages that tests must notice: they apply, and have the declared effect."""

import pytest

from benchmarks.mutants.__main__ import ROOT, drawn, package_of, stages
from benchmarks.mutants.operators import NAMED, OPERATORS, Named, changes, named_change

SOURCE = b"""
@decorated(3)
def clipped(x: "1 + 1", most=4.0):
    if x >= 0 and most > x:
        return [x - 1, -most][0]
    raise ValueError(f"{x + 1}" + "2")
"""
CHANGED = {
    "most=8.0",
    "most=2.0",
    "x < 0",
    "x > 0",
    "x >= 1",
    "0 or most",
    "most <= x",
    "most >= x",
    "[x + 1",
    "x - 2",
    ", most]",
    "[1]",
}


def test_sources_change_in_one_place() -> None:
    found = list(changes("clipped.py", SOURCE))
    assert {change.operator for change in found} == set(OPERATORS)
    sources = [change.applied(SOURCE).decode() for change in found]
    for source in sources:
        compile(source, "clipped.py", "exec")
    assert len(sources) == len(CHANGED)
    for part in CHANGED:
        assert part not in SOURCE.decode()
        assert sum(part in source for source in sources) == 1


@pytest.mark.parametrize("named", NAMED, ids=lambda named: named.line)
def test_named_changes_apply(named: Named) -> None:
    change = named_change(named, ROOT)
    source = (ROOT / change.path).read_bytes()
    assert change.applied(source) != source
    assert stages(change, ROOT)[0][0].endswith(".py")


def test_draws_are_repeated() -> None:
    first = drawn(20, 1)
    assert first == drawn(20, 1)
    assert first != drawn(20, 2)
    assert all(f"tests/{package_of(one).removeprefix('dvc/')}" in str(stages(one, ROOT)) for one in first)
