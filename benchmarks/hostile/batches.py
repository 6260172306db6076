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

from benchmarks.hostile.attempts import kinds
from decoder.parallel import stop_idle_processes
from dvc import cli
from dvc.errors import DvcError

MAX_ALLOCATION_BYTES = 2**30
MAX_SECONDS = 20
BATCH = 250
GOOD = frozenset({"refused", "decoded"})
"""Outcomes that are no failure."""

STREAMS = ("buffered", "punctured", "allocated")
GEOMETRY = ("tracks", "points", "anchors")
MESSAGES = ("to-decoder", "to-encoder")
PICTURES = ("pictures",)
DEPTH_IMAGES = ("depth-images",)
LAYERS = ("layers",)
KINDS = (*STREAMS, *GEOMETRY, *MESSAGES, *PICTURES, *DEPTH_IMAGES, *LAYERS)


@contextmanager
def guarded() -> Iterator[None]:
    """Raise `TimeoutError` in a block that takes too long."""

    def _ring(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError

    previous = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, MAX_SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def run_batch(kind: str, numbers: Sequence[int]) -> list[str]:
    """Try mutations in this process, whose memory is limited from now on."""
    attempt = kinds()[kind]
    with suppress(Exception):
        attempt(numbers[0])  # compiles kernels, and makes what is mutated: not to be timed
    stop_idle_processes()  # others inherit the limit
    with open("/proc/self/statm", encoding="ascii") as statm:
        in_use = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (in_use + MAX_ALLOCATION_BYTES, resource.RLIM_INFINITY))
    return [_outcome(attempt, number) for number in numbers]


def _outcome(attempt: Callable[[int], str], number: int) -> str:
    try:
        with guarded():
            return attempt(number)
    except TimeoutError:
        return f"hang: more than {MAX_SECONDS} s"
    except MemoryError:
        return "allocation of more than 1 GiB"
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
            command, capture_output=True, text=True, check=False, timeout=60 + 2 * MAX_SECONDS + 2 * count
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
