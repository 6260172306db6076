"""Waiting for another thread or process, and a clock that tests set."""

import time
from collections.abc import Callable

PATIENCE_S = 120.0


class Clock:
    """A clock that moves when it is set."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def wait_until(condition: Callable[[], object], gone: Callable[[], object] = lambda: None) -> None:
    """Wait until something holds; fail where whoever is to bring it about is gone."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert gone() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
