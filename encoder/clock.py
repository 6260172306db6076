"""The clock of all coding: processor time without that of compiled code being loaded."""

import time

from dvc._jit import loading_time_s


def coding_time_s() -> float:
    """Tell the processor time of this thread, but for loading of compiled code."""
    return time.thread_time() - loading_time_s()
