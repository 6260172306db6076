"""New mutations for hours: inputs that were tried with each version of the code, and harm."""

import json
import os
import secrets
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import GOOD, Try, run, stop
from benchmarks.hostile.bounds import BOUNDS
from benchmarks.results.code import ROOT, code_digest
from dvc import cli
from dvc.errors import DvcError

FUZZING, CUTS = ROOT / "docs" / "fuzzing.json", ROOT / "docs" / "cuts.json"
SCHEMA = "dvc3d-tried/1"
FIRST = 10**9
"""Smallest number of new inputs; smaller ones repeat inputs."""


@dataclass
class Part:
    """Inputs that were tried with one version of the code."""

    code: str
    date: str  # date of the last input
    bounds: bool  # whether kernels checked bounds
    seconds: dict[str, float] = field(default_factory=dict)  # by kind, of one process
    inputs: dict[str, int] = field(default_factory=dict)  # by kind
    finds: dict[str, str] = field(default_factory=dict)  # outcome by kind and number
    unsteady: dict[str, str] = field(default_factory=dict)  # finds that were not repeated


@dataclass
class Tried:
    """All parts; written in one piece after each addition, so that a kill loses only later inputs."""

    path: Path
    next_number: int
    parts: list[Part]

    @classmethod
    def read(cls, path: Path) -> "Tried":
        """Read a file, or begin one."""
        if not path.exists():
            return cls(path, FIRST + secrets.randbelow(FIRST), [])
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["schema"] != SCHEMA:
                raise DvcError(f"{path}: not of schema {SCHEMA}")
            return cls(path, data["next_number"], [Part(**part) for part in data["parts"]])
        except (ValueError, KeyError, TypeError) as err:
            raise DvcError(f"{path}: not a record of inputs: {err}") from err

    def add(
        self,
        kind: str,
        inputs: int,
        seconds: float,
        finds: Mapping[str, str],
        unsteady: Mapping[str, str],
    ) -> None:
        """Add inputs of a kind, tried with the present code."""
        code, bounds = code_digest(), os.environ.get(BOUNDS) == "1"
        if not self.parts or (self.parts[-1].code, self.parts[-1].bounds) != (code, bounds):
            self.parts.append(Part(code, "", bounds))
        part = self.parts[-1]
        part.date = datetime.now(UTC).date().isoformat()
        part.inputs[kind] = part.inputs.get(kind, 0) + inputs
        part.seconds[kind] = round(part.seconds.get(kind, 0.0) + seconds, 1)
        part.finds |= finds
        part.unsteady |= unsteady
        parts = [asdict(each) for each in self.parts]
        cli.write_json(self.path, {"schema": SCHEMA, "next_number": self.next_number, "parts": parts})

    def take(self, count: int) -> range:
        """Return new numbers."""
        self.next_number += count
        return range(self.next_number - count, self.next_number)

    @property
    def inputs(self) -> Counter[str]:
        """Inputs by kind, of all parts."""
        return sum((Counter(part.inputs) for part in self.parts), Counter[str]())

    def seconds(self, kind: str) -> float:
        """Return the time of a kind in all parts."""
        return sum(part.seconds.get(kind, 0.0) for part in self.parts)

    @property
    def finds(self) -> dict[str, str]:
        """All finds."""
        return {name: outcome for part in self.parts for name, outcome in part.finds.items()}

    @property
    def hours(self) -> float:
        """Time of all parts."""
        return sum(sum(part.seconds.values()) for part in self.parts) / 3600.0

    def summary(self) -> str:
        """Return the number of inputs by version of the code."""
        return ", ".join(
            f"{sum(part.inputs.values())} with code {part.code}"
            + ("" if part.bounds else " without bounds checks")
            for part in self.parts
        )


SLICE_S = 60.0
"""Time of one kind, before it is the next one's turn."""
_FIRST, _FEWEST, _MOST = 40, 20, 20_000
"""Mutations of the first slice of a kind, and bounds."""


def print_outcomes(tries: Sequence[Try], outcomes: Sequence[str]) -> list[Try]:
    """Print outcomes by kinds; return the mutations that did harm."""
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
    """Write mutations that did harm into a folder."""
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
    """Estimate how many mutations fill a slice of time."""
    inputs = tried.inputs[kind]
    return min(max(round(SLICE_S * inputs / tried.seconds(kind)), _FEWEST), _MOST) if inputs else _FIRST


def _slice(tries: Sequence[Try], ends_s: float) -> tuple[list[str], float]:
    started_s = time.monotonic()
    outcomes = run(tries) if started_s < ends_s else []
    return outcomes, time.monotonic() - started_s


def _add(
    tried: Tried, tries: Sequence[Try], outcomes: Sequence[str], taken_s: float, finds: Path | None
) -> int:
    """Record a slice; harm must be repeatable, since a busy machine is slow as well."""
    bad = print_outcomes(tries, outcomes)
    steady = [each for each, text in zip(bad, run(bad), strict=True) if text not in GOOD]
    keep(steady, finds)
    texts = dict(zip(tries, outcomes, strict=True))
    found, unsteady = (
        {f"{kind}/{number}": texts[kind, number] for kind, number in members}
        for members in (steady, [each for each in bad if each not in steady])
    )
    tried.add(tries[0][0], len(tries), taken_s, found, unsteady)
    line = f"{tried.hours:.2f} hours, {tried.inputs.total()} inputs, {len(tried.finds)} finds"
    print(f"  {line}", flush=True)
    return len(steady)
