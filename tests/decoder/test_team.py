"""Threads that share a core and memory: results in order, as many at a time as there is room for."""

import threading
import time
from functools import partial

import pytest

from decoder.team import Budget, Team
from tests.waiting import wait_until


def test_results_keep_their_order() -> None:
    """Whoever is first; and the first failure, in their order, is raised."""
    team = Team()

    def late(number: int) -> int:
        time.sleep(0.01 * (3 - number))
        return number

    assert team.run([partial(late, number) for number in range(4)]) == [0, 1, 2, 3]

    def fail(number: int) -> int:
        raise ValueError(str(number))

    with pytest.raises(ValueError, match="1"):
        team.run([lambda: 0, lambda: fail(1), lambda: fail(2)])


def test_one_computes_while_others_wait() -> None:
    """Whoever waits for an answer leaves the core to the next."""
    team, both = Team(), threading.Barrier(2)
    running = most = 0

    def work() -> None:
        nonlocal running, most
        running += 1
        most = max(most, running)
        time.sleep(0.02)
        running -= 1
        with team.core.given(1):
            both.wait(timeout=30)

    team.run([work] * 2)
    assert most == 1


class Takers:
    """Threads that wait for a budget, take their part, and keep it until they are told to go."""

    def __init__(self, budget: Budget) -> None:
        self._budget = budget
        self.began: list[str] = []
        self._leaving: dict[str, threading.Event] = {}
        self._threads: dict[str, threading.Thread] = {}

    def begin(self, name: str, amount: int, *rank: int) -> None:
        """Let a thread ask for a part, which comes after those that asked before."""
        self._leaving[name] = threading.Event()
        thread = self._threads[name] = threading.Thread(target=self._take, args=(name, amount, rank))
        waiting = self._num_waiting()
        thread.start()
        wait_until(lambda: name in self.began or self._num_waiting() > waiting)

    def _num_waiting(self) -> int:
        with self._budget._lock:
            return len(self._budget._waiting)

    def _take(self, name: str, amount: int, rank: tuple[int, ...]) -> None:
        with self._budget.taken(amount, rank):
            self.began.append(name)
            self._leaving[name].wait()

    def leave(self, name: str) -> None:
        """Let a thread give back what it has."""
        self._leaving[name].set()
        self._threads[name].join()


def test_the_lowest_rank_comes_first_as_long_as_there_is_room() -> None:
    """Nobody overtakes who is first but does not fit; who asks for more than all has it alone."""
    takers = Takers(Budget(10))
    takers.begin("a", 5, -1, 0)
    takers.begin("b", 6, -2, 1)
    takers.begin("c", 5, -2, 0)
    assert takers.began == ["a", "c"]
    takers.begin("d", 1, -1, 9)
    assert takers.began == ["a", "c"]
    takers.leave("a")
    assert takers.began == ["a", "c"]
    takers.leave("c")
    wait_until(lambda: sorted(takers.began[2:]) == ["b", "d"])
    takers.begin("e", 30, -1)
    takers.begin("f", 1, -1)
    takers.leave("b")
    assert len(takers.began) == 4
    takers.leave("d")
    wait_until(lambda: takers.began[4:] == ["e"])
    takers.leave("e")
    wait_until(lambda: takers.began[4:] == ["e", "f"])
    takers.leave("f")


def test_what_is_left_to_others_is_taken_again() -> None:
    """Others go on meanwhile, and the one that comes back waits for its turn."""
    budget, order = Budget(1), list[str]()
    back = threading.Event()

    def other() -> None:
        with budget.taken(1):
            order.append("other")
            back.wait()

    thread = threading.Thread(target=other)
    with budget.taken(1):
        thread.start()
        wait_until(lambda: budget._waiting)
        with budget.given(1):
            wait_until(lambda: order)
            threading.Timer(0.05, lambda: (order.append("goes"), back.set())).start()
        order.append("again")
    thread.join()
    assert order == ["other", "goes", "again"]
