"""Time by stage: of the innermost one, and every function that is named exists."""

import time
from collections.abc import Callable
from typing import Any

import pytest

from benchmarks import stages
from benchmarks.stages import REST, STAGES, Clock, table, watch


def test_time_counts_for_the_innermost_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0

    def passing(seconds: float) -> Callable[[], None]:
        def work() -> None:
            nonlocal now_s
            now_s += seconds

        return work

    monkeypatch.setattr(time, "process_time", lambda: now_s)
    clock = Clock()
    inner = clock.timed("inner", passing(2.0))
    between = passing(1.0)
    outer = clock.timed("outer", lambda: (between(), inner(), between()))
    outer()
    passing(0.5)()
    clock.turn()
    assert clock.spent_s == {REST: 0.5, "outer": 2.0, "inner": 2.0}
    lines = table(clock.spent_s, 5).splitlines()
    assert [line.split()[-3:] for line in lines[-1:]] == [["900.0", "100.0", "%"]]


def test_stages_are_functions_that_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    timed: list[str] = []

    class Noting(Clock):
        def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
            timed.append(stage)
            return function

    watch(Noting())
    assert set(timed) == set(STAGES)
    assert stages.REST not in STAGES
