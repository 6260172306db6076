"""Threads that share a level: results in order, as many at a time as there are cores."""

import threading
import time
from functools import partial

import pytest

from decoder.team import Team


def test_results_keep_their_order() -> None:
    """Whoever is first; and the first failure, in their order, is raised."""
    team = Team()
    team.resize(4)

    def late(number: int) -> int:
        time.sleep(0.01 * (3 - number))
        return number

    assert team.run([partial(late, number) for number in range(4)]) == [0, 1, 2, 3]

    def fail(number: int) -> int:
        raise ValueError(str(number))

    with pytest.raises(ValueError, match="1"):
        team.run([lambda: 0, lambda: fail(1), lambda: fail(2)])


@pytest.mark.parametrize("cores", [1, 3])
def test_no_more_run_than_there_are_cores(cores: int) -> None:
    """One after the other by default; all cores are used where there are more."""
    team, lock = Team(), threading.Lock()
    team.resize(cores)
    running = most = 0

    def work() -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.05)
        with lock:
            running -= 1

    team.run([work] * 6)
    assert most == cores


def test_cores_may_come_while_a_level_is_decoded() -> None:
    """What waits for a core begins when there is one more."""
    team, both = Team(), threading.Barrier(2)
    threading.Timer(0.05, team.resize, (2,)).start()
    assert len(team.run([lambda: both.wait(timeout=30)] * 2)) == 2
