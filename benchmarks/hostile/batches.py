"""Mutations in child processes, a batch at a time, so that a crash or a hang is counted and ends no run."""

import json
import resource
import signal
import subprocess
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

from benchmarks.hostile.attempts import Kind, kinds
from decoder.parallel import stop_idle_processes
from dvc import cli
from dvc.errors import DvcError

BATCH = 250
COMPILING_S = 600.0
GOOD = frozenset({"refused", "decoded"})
"""Outcomes that are no failure."""

KINDS = tuple(kinds())


def max_seconds(num_pixels: int) -> float:
    """Return how long a mutation may take, by the size of what was mutated."""
    return 5.0 + 200e-6 * num_pixels


def max_bytes(num_pixels: int) -> int:
    """Return how much memory it may take beyond what the process holds; volumes of depth are the most."""
    return (192 << 20) + (num_pixels << 10)


@contextmanager
def guarded(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` in a block that takes too long."""

    def _ring(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError

    previous = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def run_batch(kind: str, numbers: Sequence[int]) -> list[str]:
    """Try mutations in this process, whose memory is limited from now on."""
    chosen = kinds()[kind]
    with suppress(Exception):
        chosen.outcome(chosen.damaged(numbers[0]))  # compiles kernels, which is not to be timed
    stop_idle_processes()  # others inherit the limit
    with open("/proc/self/statm", encoding="ascii") as statm:
        in_use = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (in_use + max_bytes(chosen.num_pixels), resource.RLIM_INFINITY))
    return [_outcome(chosen, number) for number in numbers]


def _outcome(kind: Kind, number: int) -> str:
    seconds = max_seconds(kind.num_pixels)
    try:
        damaged = kind.damaged(number)
        with guarded(seconds):
            return kind.outcome(damaged)
    except TimeoutError:
        return f"hang: more than {seconds:.0f} s"
    except MemoryError:
        return f"allocation of more than {max_bytes(kind.num_pixels) >> 20} MiB"
    except DvcError as err:
        return f"unexpected {type(err).__name__}: {cli.one_line(err)}"
    except Exception as err:
        place = traceback.extract_tb(err.__traceback__)[-1]
        return f"traceback: {type(err).__name__} in {place.name}: {cli.one_line(err)}"


def run_kind(
    kind: str, first: int, count: int, progress: Callable[[int], None] = lambda _: None
) -> dict[int, str]:
    """Try mutations in child processes."""
    outcomes: dict[int, str] = {}
    batches = [(first + done, min(BATCH, count - done)) for done in range(0, count, BATCH)]
    while batches:
        begin, length = batches.pop()
        found = _child(kind, begin, length)
        if isinstance(found, str) and length > 1:
            # One of them ended the process: narrow it down.
            half = length // 2
            batches += [(begin, half), (begin + half, length - half)]
            continue
        outcomes |= {begin: found} if isinstance(found, str) else dict(enumerate(found, begin))
        progress(length)
    return outcomes


def _child(kind: str, first: int, count: int) -> list[str] | str:
    command = [sys.executable, "-m", "benchmarks.hostile", "--kind", kind, "--child"]
    command += ["--first", str(first), "--count", str(count)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=COMPILING_S + 10 * count
        )
    except subprocess.TimeoutExpired:
        return "hang: the process had to be killed"
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        return f"crash: status {done.returncode} {said[-1] if said else ''}"
    outcomes: list[str] = json.loads(done.stdout)
    return outcomes


def summary(outcomes: dict[int, str]) -> tuple[Counter[str], dict[int, str]]:
    """Count outcomes."""
    return Counter(outcomes.values()), {n: text for n, text in sorted(outcomes.items()) if text not in GOOD}
