"""Processes that decode groups of pictures, whose libraries do not depend on the processor.

What a decoder predicts decides what it asks for, so a punctured stream can only be decoded where the very
same predictions are made. Libraries choose their code by the processor when they load: the processes are
started with an environment that holds them to one baseline, whatever the program that imports this module
has loaded before.
"""

import atexit
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import Pipe
from threading import Lock

from decoder.tasks import Answered, DecodedGroup, GroupTask
from dvc.environment import baseline_environment
from dvc.errors import DvcError
from dvc.slepian_wolf import ParityRequest

Outcome = Sequence[ParityRequest] | DecodedGroup | Exception
_MAX_IDLE = 2  # processes kept for the next sequence: they take about a second to start, and some memory


class DecodingProcess:
    """A process that decodes groups; see `decoder.worker`."""

    def __init__(self) -> None:
        self.num_running = self.num_pending = 0
        self.step_s = self._began_s = 0.0
        self._connection, other = Pipe()
        command = [sys.executable, "-P", "-m", "decoder.worker", str(other.fileno())]
        # Whoever starts the process ends it; an interrupt from the terminal is not for it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            with other:
                self._process = subprocess.Popen(
                    command,
                    env=baseline_environment(),
                    pass_fds=[other.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def submit(self, message: GroupTask | Answered) -> None:
        """Begin a group, besides those that are under way, or go on with one."""
        self.num_running += isinstance(message, GroupTask)
        if not self.num_pending:
            self._began_s = time.monotonic()
        self.num_pending += 1
        try:
            self._connection.send(message)
        except OSError as err:
            raise self._death() from err

    def receive(self) -> tuple[int, Outcome]:
        """Wait for what a group asks for, or comes to."""
        try:
            number, outcome, answers = self._connection.recv()
        except (EOFError, OSError) as err:
            raise self._death() from err
        self.num_running -= isinstance(outcome, DecodedGroup | Exception)
        self.num_pending -= answers  # not a level that was begun by itself
        now_s = time.monotonic()
        self.step_s, self._began_s = now_s - self._began_s, now_s
        return number, outcome

    def fileno(self) -> int:
        """Return the file descriptor that can be read when something is to be received."""
        return self._connection.fileno()

    def _death(self) -> DvcError:
        try:  # a process that ends by itself says how
            status = self._process.wait(timeout=1)
        except subprocess.TimeoutExpired:
            self.kill()
            status = self._process.wait()
        how = (
            "was killed; is there enough memory for --jobs?" if status < 0 else f"ended with status {status}"
        )
        return DvcError(f"a decoding process {how}")

    @property
    def alive(self) -> bool:
        """Whether it can decode."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Make it end, whatever it does."""
        self._process.kill()

    def stop(self) -> None:
        """End it, and let go of it."""
        self.kill()
        self._process.wait()
        self._connection.close()


_idle: list[DecodingProcess] = []
_lock = Lock()


@atexit.register
def stop_idle_processes() -> None:
    """Keep no process for a next sequence, which gets new ones."""
    while _idle:
        _idle.pop().stop()


@contextmanager
def decoding_process() -> Iterator[DecodingProcess]:
    """Lend a process; one that comes back at work is stopped, others are kept for the next."""
    with _lock:
        process = _idle.pop() if _idle else None
    if process is not None and not process.alive:
        process.stop()
        process = None
    process = process or DecodingProcess()
    try:
        yield process
    finally:
        with _lock:
            kept = process.num_running == 0 and process.alive and len(_idle) < _MAX_IDLE
            if kept:
                _idle.append(process)
        if not kept:
            process.stop()
