"""Links between threads of one process."""

import time

from dvc.feedback import Link, Listener, welcome
from dvc.feedback.opening import read_opening


def accepted(listener: Listener, timeout_s: float, patience_s: float = 0.0) -> Link:
    """Wait for a decoder that dials, and begin a stream with it."""
    connection = listener.accept(timeout_s, timeout_s)
    asked = connection.talk(lambda peer: read_opening(peer, time.monotonic() + timeout_s))
    return welcome(connection, asked, timeout_s, patience_s)
