"""Threads that decode frames of a level side by side: as many at a time as the process may use cores."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Condition
from typing import TypeVar

Result = TypeVar("Result")

MAX_THREADS = 16
"""Most that a level is shared by."""


class Team:
    """Runs what does not depend on each other; while it runs, the number of cores may change."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._changed = Condition()
        self._num_cores = self._num_free = 1

    def resize(self, num_cores: int) -> None:
        """Use another number of cores from now on."""
        with self._changed:
            self._num_free += num_cores - self._num_cores
            self._num_cores = num_cores
            self._changed.notify_all()

    def run(self, functions: Sequence[Callable[[], Result]]) -> list[Result]:
        """Call functions; return what they return, in their order, or raise what the first of them raises."""
        if len(functions) == 1:
            return [functions[0]()]
        self._pool = self._pool or ThreadPoolExecutor(MAX_THREADS)
        return list(self._pool.map(self._call, functions))

    def _call(self, function: Callable[[], Result]) -> Result:
        with self._changed:
            self._changed.wait_for(lambda: self._num_free > 0)
            self._num_free -= 1
        try:
            return function()
        finally:
            with self._changed:
                self._num_free += 1
                self._changed.notify()
