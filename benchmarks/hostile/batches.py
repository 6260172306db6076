"""Mutations in child processes, a batch at a time, so that a crash or a hang is counted and ends no run."""

import os
import resource
import signal
import subprocess
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from tempfile import TemporaryFile
from threading import Event, Timer
from types import FrameType

from benchmarks.hostile.attempts import Kind, kinds
from benchmarks.hostile.bounds import BOUNDS, check_bounds
from benchmarks.hostile.workers import forked_workers
from decoder.processes import stop_idle_processes
from dvc import cli
from dvc.environment import child_environment, python_module
from dvc.errors import DvcError
from dvc.memory import address_bytes

COMPILING_S, STALLED_S = 900.0, 120.0
"""Longest silence of a process: at first, while it may compile all kernels, and later."""
GOOD = frozenset({"refused", "decoded"})
"""Outcomes that are no failure."""

KINDS = tuple(kinds())
Advance = Callable[[int], None]
Try = tuple[str, int]
"""A kind, and the number of a mutation."""
_running: list[subprocess.Popen[str]] = []
_stopping = Event()


def max_seconds(num_pixels: int) -> float:
    """Return the time limit of a mutation, by the size of its input."""
    return 5.0 + 200e-6 * num_pixels


def max_bytes(num_pixels: int) -> int:
    """Return the limit of additional memory of a mutation; volumes of depth need most."""
    return (192 << 20) + (num_pixels << 10)


class TooLong(BaseException):
    """A block takes too long; not an `Exception`, so that no reader handles it as bad input."""


@contextmanager
def _limited_time(seconds: float) -> Iterator[None]:
    """Raise `TooLong` in a block that does."""

    def _ring(_signal: int, _frame: FrameType | None) -> None:
        raise TooLong

    previous = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


@contextmanager
def _limited_memory(most: int) -> Iterator[None]:
    """Limit the additional memory of a block and of processes that it starts."""
    resource.setrlimit(resource.RLIMIT_AS, (address_bytes() + most, resource.RLIM_INFINITY))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def run_batch(tries: Sequence[Try]) -> Iterator[str]:
    """Try mutations in this process, and yield the outcome of each."""
    before = None
    if os.environ.get(BOUNDS) == "1":
        check_bounds()
    with forked_workers():
        for kind, number in tries:
            chosen = kinds()[kind]
            if kind != before:
                with suppress(Exception):
                    chosen.outcome(chosen.damaged(number))  # loads kernels, and makes the good input
                stop_idle_processes()  # new processes inherit the limit
                before = kind
            outcome = outcome_of(chosen, chosen.damaged(number))
            # Kernels that nothing has called before take time and memory as well: only once.
            yield outcome if outcome in GOOD else outcome_of(chosen, chosen.damaged(number))


def outcome_of(kind: Kind, damaged: bytes) -> str:
    """Return the outcome of damaged input, within limits that grow with its size."""
    size = kind.num_pixels + len(damaged)  # every byte counts as a pixel
    seconds, most = max_seconds(size), max_bytes(size)
    try:
        with _limited_memory(most), _limited_time(seconds):
            return kind.outcome(damaged)
    except TooLong:
        return f"hang: more than {seconds:.0f} s"
    except MemoryError:
        return f"allocation of more than {most >> 20} MiB"
    except DvcError as err:
        return f"unexpected {type(err).__name__}: {cli.one_line(err)}"
    except Exception as err:
        place = traceback.extract_tb(err.__traceback__)[-1]
        return f"traceback: {type(err).__name__} in {place.name}: {cli.one_line(err)}"


def run(tries: Sequence[Try], advance: Advance = lambda _: None) -> list[str]:
    """Try mutations in a child process, and in a new one after each that ends it."""
    outcomes: list[str] = []
    while len(outcomes) < len(tries) and not _stopping.is_set():
        found, ended = _child(tries[len(outcomes) :], advance)
        outcomes += found
        if len(outcomes) < len(tries):
            outcomes.append(ended)
            advance(1)
    return outcomes


def _child(tries: Sequence[Try], advance: Advance) -> tuple[list[str], str]:
    """Return the outcomes of a process, and the way in which it ended."""
    command = python_module("benchmarks.hostile", "--child")
    outcomes: list[str] = []
    with TemporaryFile("w+") as tasks, TemporaryFile() as errors:
        tasks.writelines(f"{kind} {number}\n" for kind, number in tries)
        tasks.seek(0)
        with subprocess.Popen(
            command, env=child_environment(), stdin=tasks, stdout=subprocess.PIPE, stderr=errors, text=True
        ) as process:
            _running.append(process)
            assert process.stdout is not None
            watchdog = Watchdog(process.kill)
            for line in process.stdout:
                kind, _ = tries[len(outcomes)]
                outcomes.append(line.rstrip("\n"))
                advance(1)
                watchdog.feed(STALLED_S + 10 * max_seconds(kinds()[kind].num_pixels))
            watchdog.stop()
            _running.remove(process)
        errors.seek(0)
        last = errors.read().decode(errors="replace").strip().rpartition("\n")[2]
    hung = "hang: the process had to be killed"
    return outcomes, hung if watchdog.barked else f"crash: status {process.returncode} {last}"


def stop() -> None:
    """End all processes, and start no further ones."""
    _stopping.set()
    for process in list(_running):
        process.kill()


class Watchdog:
    """Calls a function unless it is fed in time."""

    def __init__(self, bark: Callable[[], None]) -> None:
        self._bark = bark
        self.barked = False
        self.feed(COMPILING_S)

    def feed(self, seconds: float) -> None:
        """Keep it quiet for a while."""
        self.stop()
        self._timer = Timer(seconds, self._wake)
        self._timer.start()

    def stop(self) -> None:
        """Send it to sleep."""
        if hasattr(self, "_timer"):
            self._timer.cancel()

    def _wake(self) -> None:
        self.barked = True
        self._bark()
