"""Child processes of an experiment: started fresh, timed, and stopped together."""

import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

from dvc.environment import SINGLE_THREADED, child_environment
from dvc.errors import DvcError

_MAX_MESSAGE_BYTES = 4096


class Stopped(Exception):
    """A process ended because `ProcessGroup.stop` was called."""


@dataclass(frozen=True)
class ProcessTimes:
    """Times of a finished process, in seconds."""

    cpu_s: float  # processor time of the process and of its finished children
    wall_s: float  # time from start to end


class ProcessGroup:
    """Runs commands from any number of threads, and can stop all that are running."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[int] = set()
        self._stopped = False

    def run(self, command: Sequence[str], output: IO[bytes] | None = None) -> ProcessTimes:
        """Run a command to its end."""
        with tempfile.TemporaryFile() as errors:
            started = time.perf_counter()
            with self._lock:
                if self._stopped:
                    raise Stopped
                try:
                    process = subprocess.Popen(
                        command,
                        stdin=subprocess.DEVNULL,
                        stdout=output or subprocess.DEVNULL,
                        stderr=errors,
                        env=child_environment() | SINGLE_THREADED,
                        start_new_session=True,
                    )
                except OSError as err:
                    raise DvcError(f"cannot start {command[0]}: {err.strerror}") from err
                self._running.add(process.pid)
            try:
                _, status, usage = os.wait4(process.pid, 0)
            except BaseException:
                _terminate(process.pid)
                process.wait()
                raise
            finally:
                with self._lock:
                    self._running.discard(process.pid)
            process.returncode = os.waitstatus_to_exitcode(status)
            self.pause(0.0)
            if process.returncode != 0:
                if process.returncode < 0:
                    raise DvcError(f"the process was ended by {signal.Signals(-process.returncode).name}")
                errors.seek(max(0, errors.seek(0, os.SEEK_END) - _MAX_MESSAGE_BYTES))
                lines = errors.read().decode("utf-8", "replace").split("\n")
                messages = [line.strip() for line in lines if line.strip()]
                raise DvcError([f"the process ended with status {process.returncode}", *messages][-1])
            return ProcessTimes(usage.ru_utime + usage.ru_stime, time.perf_counter() - started)

    def stop(self) -> None:
        """End all running commands with their children; no other can be started."""
        with self._lock:
            self._stopped = True
            for group in self._running:
                _terminate(group)

    def pause(self, time_s: float) -> None:
        """Sleep, then raise `Stopped` if the group was stopped."""
        time.sleep(time_s)
        with self._lock:
            if self._stopped:
                raise Stopped


def _terminate(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGTERM)
