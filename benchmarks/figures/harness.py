"""What all figures share: their definition, what a measurement returns, and timed child processes."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import cycle, islice
from pathlib import Path
from typing import Any, TypeVar

from dvc.errors import ConfigError, DvcError
from dvc.rd.processes import ProcessGroup
from dvc.rd.sources import Source, default_cache, find_source

RESULTS = Path("results") / "figures"
STATIC_CLIPS = ("box", "desk", "river", "stone", "tree")
SCENES = ("street", "stairway", "statue")
FOREMAN = "foreman_qcif15"
Item = TypeVar("Item")
Row = dict[str, Any]
"""A row of the document."""
Key = tuple[str, str, str | None]
"""What tells a row from all others: area, name and clip."""


@dataclass(frozen=True)
class Setting:
    """How thoroughly to measure."""

    # only prove that the measurement works: few frames, few repetitions; such figures are not kept
    quick: bool = False
    frames: int = 51  # frames of the rate-distortion curves of CIF clips
    jobs: int = 1  # points of a rate-distortion curve that are measured at the same time
    folder: Path = RESULTS  # for intermediate results
    # keep points that other versions of the code have measured, after changes that leave streams alone
    any_version: bool = False
    points: tuple[Path, ...] = ()  # experiments of `dvc-rd` whose points are read; others are measured

    def choose(self, full: int, quick: int) -> int:
        """Return one of two numbers."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Measured:
    """What a measurement found."""

    got: str  # the figure as text
    holds: bool | None  # whether what is asked holds; None where nothing is asked but the true figure
    # the numbers behind the text, with units in their names
    values: dict[str, Any] = field(default_factory=dict)
    note: str = ""  # what a reader must know beside it


@dataclass(frozen=True)
class Figure:
    """A figure that is asked of the project."""

    area: str  # part of the project
    name: str  # unique in its area
    title: str  # what is measured
    asked: str  # what it must reach
    # takes the setting, and the name of a clip, which is empty for figures without one; returns `Measured`.
    # All measurements begin like this, so their docstrings say what is measured and what it gives
    measure: Callable[[Setting, str], Measured]
    clips: tuple[str | None, ...] = (None,)  # sequences to measure it on
    thesis: str = ""  # what the thesis reports, if anything
    on_request: bool = False  # measured only where its name is given, because it takes long
    slow: bool = False  # cannot be tried out in a minute: a quick run leaves it out, unless its name is given
    # packages that the measurement depends on, beside all that its code reaches and names
    programs: tuple[str, ...] = ()

    def row(self, clip: str | None, measured: Measured | None, note: str = "") -> Row:
        """Return the row of `docs/figures.json`."""
        command = f"python -m benchmarks.figures --area {self.area} --name {self.name}"
        found = (
            {"got": None, "holds": None, "values": {}, "note": note} if measured is None else asdict(measured)
        )
        return {
            "area": self.area,
            "name": self.name,
            "title": self.title,
            "clip": clip,
            "asked": self.asked,
            "thesis": self.thesis or None,
            "got": found["got"],
            "holds": found["holds"],
            "values": found["values"],
            "note": found["note"],
            "command": command if clip is None else f"{command} --clip {clip}",
            "date": None if measured is None else today(),
            "code": None,
            "machine": None,
            "before": None,
        }


def today() -> str:
    """Return the date, UTC, as rows have it."""
    return datetime.now(UTC).date().isoformat()


def mean_over_clips(
    setting: Setting,
    clips: Sequence[str],
    measure: Callable[[str], float],
    text: str,
    holds: Callable[[float], bool],
) -> Measured:
    """Average a number over sequences; in a quick run it is that of the first."""
    found = {clip: measure(clip) for clip in clips[: setting.choose(len(clips), 1)]}
    mean = sum(found.values()) / len(found)
    each = ", ".join(f"{clip} {value:+.1f}" for clip, value in found.items())
    return Measured(f"{text.format(mean)} over {len(found)} clips ({each})", holds(mean), dict(found))


def there_and_back(frames: Sequence[Item], num_frames: int) -> Iterator[Item]:
    """Play a sequence forwards, backwards, and so on: a long one without a cut."""
    return islice(cycle([*frames, *frames[-2:0:-1]]), num_frames)


class MissingClip(Exception):
    """A sequence that a figure is measured on is not there."""


def clip_source(clip: str) -> Source:
    """Find a sequence."""
    try:
        return find_source(clip, default_cache(), ProcessGroup())
    except ConfigError as err:
        raise MissingClip(f"not measured: no sequence {clip!r} in the data folder") from err


@dataclass(frozen=True)
class Usage:
    """Resources of a finished process."""

    wall_s: float  # seconds; the latter of all its processes together
    cpu_s: float
    peak_bytes: int  # largest resident size that one of its processes had


# A process inherits the peak of the one that started it until it has loaded its program, so a small one does.
_LAUNCHER = """
import json, resource, subprocess, sys, time
started = time.perf_counter()
status = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
wall = time.perf_counter() - started
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([status, wall, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024]))
"""


def run_module(
    module: str,
    arguments: Sequence[object],
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> Usage:
    """Run a module of the project in a fresh process."""
    command = [
        sys.executable,
        "-I",
        "-S",
        "-c",
        _LAUNCHER,
        sys.executable,
        "-m",
        module,
        *map(str, arguments),
    ]
    launched = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=folder, env=environment
    )
    status, wall_s, cpu_s, peak_bytes = json.loads(launched.stdout)
    if status != 0:
        raise DvcError(f"python -m {module} ended with status {status}: {launched.stderr.strip()[-300:]}")
    return Usage(wall_s, cpu_s, peak_bytes)
