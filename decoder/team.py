"""Threads that decode frames of live groups side by side, as many as there is memory for."""

import heapq
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import count
from threading import Lock
from typing import TypeVar

Result = TypeVar("Result")
Rank = tuple[int, ...]

MAX_THREADS = 128
"""Most frames that are under way, those included that wait for a core or for answers."""
MAX_ACTIVE_PX = 3 << 20
"""Pixels of frames of live groups that are decoded at a time, where that leaves one level of one group.
`benchmarks.speed box --frames 241 --long-delay --delay .1 --bandwidth 1e6`, live: 209 s with 2.3 << 20, 173
with 3, 175 with 4, 170 with 8."""


class Budget:
    """So much of something, which threads take and give back; the lowest rank that waits comes first."""

    def __init__(self, size: int) -> None:
        self._size, self._used = size, 0
        self._waiting: list[tuple[Rank, int, int, Lock]] = []
        self._arrivals = count()
        self._lock = Lock()

    @contextmanager
    def taken(self, amount: int, rank: Rank = ()) -> Iterator[None]:
        """Take some for a block, as soon as there is so much, or nobody else has any."""
        self._take(amount, rank)
        try:
            yield
        finally:
            self._give(amount)

    @contextmanager
    def given(self, amount: int, rank: Rank = ()) -> Iterator[None]:
        """Leave to others what was taken, while a block waits for something else."""
        self._give(amount)
        try:
            yield
        finally:
            self._take(amount, rank)

    def _take(self, amount: int, rank: Rank) -> None:
        turn = Lock()
        turn.acquire()
        with self._lock:
            heapq.heappush(self._waiting, (rank, next(self._arrivals), amount, turn))
            self._serve()
        turn.acquire()

    def _give(self, amount: int) -> None:
        with self._lock:
            self._used -= amount
            self._serve()

    def _serve(self) -> None:
        while self._waiting and (self._used == 0 or self._used + self._waiting[0][2] <= self._size):
            _, _, amount, turn = heapq.heappop(self._waiting)
            self._used += amount
            turn.release()


class Team:
    """Threads that decode frames of live groups: one at a time computes while others wait for answers."""

    def __init__(self) -> None:
        self.core, self.pixels = Budget(1), Budget(MAX_ACTIVE_PX)
        self._pool = ThreadPoolExecutor(MAX_THREADS)

    def run(self, functions: Sequence[Callable[[], Result]], rank: Rank = ()) -> list[Result]:
        """Call functions; return what they return, in their order, or raise what the first of them raises."""

        def call(function: Callable[[], Result]) -> Result:
            with self.core.taken(1, rank):
                return function()

        if len(functions) == 1:
            return [call(functions[0])]
        return list(self._pool.map(call, functions))
