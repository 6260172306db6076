"""Waiting for what another thread or process will do."""

import time
from collections.abc import Callable

PATIENCE_S = 120.0


def wait_until(condition: Callable[[], object], gone: Callable[[], object] = lambda: None) -> None:
    """Wait until something holds; fail where whoever is to bring it about is gone."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert gone() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
