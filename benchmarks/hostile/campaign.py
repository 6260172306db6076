"""Hours of mutations that nobody has tried; what is told of outcomes, and kept of what does harm."""

import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import GOOD, Try, run, stop
from benchmarks.hostile.parts import Tried

SLICE_S = 60.0
"""Time of one kind, before it is the next one's turn."""
_FIRST, _FEWEST, _MOST = 40, 20, 20_000
"""Mutations of a slice: where nothing is known of a kind, and bounds."""


def tell(tries: Sequence[Try], outcomes: Sequence[str]) -> list[Try]:
    """Print outcomes by kinds; return what did harm."""
    found = list(zip(tries, outcomes, strict=True))
    for chosen in dict.fromkeys(kind for kind, _ in tries):
        counts = Counter(text for (kind, _), text in found if kind == chosen and text in GOOD)
        good = ", ".join(f"{count} {text}" for text, count in counts.most_common())
        print(f"{chosen}: {good}", flush=True)
        for (kind, number), text in found:
            if kind == chosen and text not in GOOD:
                print(f"  {number}: {text}", flush=True)
    return [each for each, text in found if text not in GOOD]


def keep(tries: Sequence[Try], finds: Path | None) -> None:
    """Write what did harm into a folder."""
    for kind, number in tries:
        if finds is not None:
            (finds / kind).mkdir(parents=True, exist_ok=True)
            (finds / kind / f"{number}.bin").write_bytes(kinds()[kind].damaged(number))


def fuzz(tried: Tried, chosen: Sequence[str], hours: float, jobs: int, finds: Path | None) -> int:
    """Try mutations of all kinds in turn until the time is over; return how many did harm twice."""
    ends_s, harmful = time.monotonic() + 3600.0 * hours, 0
    with ThreadPoolExecutor(jobs) as pool:
        try:
            while time.monotonic() < ends_s:
                slices = [[(kind, n) for n in tried.take(_count(tried, kind))] for kind in chosen]
                for tries, (outcomes, taken_s) in zip(
                    slices, pool.map(lambda tries: _slice(tries, ends_s), slices), strict=True
                ):
                    if outcomes:
                        harmful += _add(tried, tries[: len(outcomes)], outcomes, taken_s, finds)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            stop()
            raise
    return harmful


def _count(tried: Tried, kind: str) -> int:
    """Return how many mutations take a slice of time, told by those before."""
    inputs = tried.inputs[kind]
    return min(max(round(SLICE_S * inputs / tried.seconds(kind)), _FEWEST), _MOST) if inputs else _FIRST


def _slice(tries: Sequence[Try], ends_s: float) -> tuple[list[str], float]:
    started_s = time.monotonic()
    outcomes = run(tries) if started_s < ends_s else []
    return outcomes, time.monotonic() - started_s


def _add(
    tried: Tried, tries: Sequence[Try], outcomes: Sequence[str], taken_s: float, finds: Path | None
) -> int:
    """Write down what was tried; what does harm must do so twice, since a busy machine is slow as well."""
    bad = tell(tries, outcomes)
    steady = [each for each, text in zip(bad, run(bad), strict=True) if text not in GOOD]
    keep(steady, finds)
    texts = dict(zip(tries, outcomes, strict=True))
    found, unsteady = (
        {f"{kind}/{number}": texts[kind, number] for kind, number in which}
        for which in (steady, [each for each in bad if each not in steady])
    )
    tried.add(tries[0][0], len(tries), taken_s, found, unsteady)
    told = f"{tried.hours:.2f} hours, {tried.inputs.total()} inputs, {len(tried.finds)} finds"
    print(f"  {told}", flush=True)
    return len(steady)
