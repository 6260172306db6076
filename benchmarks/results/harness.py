"""Settings, measured values, clips, and timed child processes of all results."""

import json
import statistics
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle, islice
from pathlib import Path
from typing import Any, TypeVar

from dvc.environment import child_environment, python_module
from dvc.errors import ConfigError, DvcError
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.originals import Source, default_cache, find_source

SCENES = ("street", "stairway", "statue")
STATIC_CLIPS = ("box", "desk", "river", "stone", "tree")
CLIPS = (*STATIC_CLIPS, "cube", *SCENES)
QUICK_CLIPS = ("box", "street")
FOLDER = Path("results") / "headline"
Item = TypeVar("Item")


class Missing(DvcError):
    """Missing material of a result."""


@dataclass(frozen=True)
class Setting:
    """Extent of the measurements."""

    quick: bool = False  # few clips and frames to try a measurement; its result is not kept
    jobs: int = 2
    folder: Path = FOLDER  # folder of intermediate results

    def choose(self, full: Any, quick: Any) -> Any:
        """Return one of two values."""
        return quick if self.quick else full

    def clips(self, names: Sequence[str] = CLIPS) -> list[str]:
        """Return the existing clips, and report missing ones."""
        found = []
        for name in [name for name in names if not self.quick or name in QUICK_CLIPS]:
            try:
                clip_source(name)
                found.append(name)
            except Missing as err:
                print(err, file=sys.stderr)
        if not found:
            raise Missing(f"none of {', '.join(names)} is there")
        return found

    def scratch(self, name: str) -> Path:
        """Return a folder for intermediate results."""
        folder = self.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder


@dataclass(frozen=True)
class Measured:
    """A measured value."""

    value: float
    by_clip: Mapping[str, float] = field(default_factory=dict)  # terms of the mean
    frames: int | None = None  # number of frames of each clip
    note: str = ""  # remark for readers


def mean_of(by_clip: Mapping[str, float], frames: int | None = None, note: str = "") -> Measured:
    """Average over clips."""
    return Measured(statistics.fmean(by_clip.values()), by_clip, frames, note)


def clip_source(clip: str) -> Source:
    """Find a clip; scenes are rendered on the first request."""
    try:
        return find_source(clip, default_cache(), ProcessGroup())
    except ConfigError as err:
        raise Missing(f"not measured on {clip}: no such clip in $DVC_DATA or ../shared/sequences") from err


def there_and_back(frames: Sequence[Item], num_frames: int) -> Iterator[Item]:
    """Play frames forwards, backwards, and so on: a long sequence without a cut."""
    return islice(cycle([*frames, *frames[-2:0:-1]]), num_frames)


@dataclass(frozen=True)
class Usage:
    """Resources of a finished process and all that it has started."""

    wall_s: float
    cpu_s: float
    peak_bytes: int  # peak of one of its processes


# A process inherits the peak of the one that started it until it has loaded its program, so a small one does.
_LAUNCHER = """
import json, resource, subprocess, sys, time
started = time.perf_counter()
status = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
wall = time.perf_counter() - started
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([status, wall, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024]))
"""


def run_module(module: str, *arguments: object) -> Usage:
    """Run a module of the project in a fresh process, to its end."""
    python, *words = python_module(module, *arguments)
    command = [python, "-I", "-S", "-c", _LAUNCHER, python, *words]
    launched = subprocess.run(command, env=child_environment(), capture_output=True, text=True, check=True)
    status, wall_s, cpu_s, peak_bytes = json.loads(launched.stdout)
    if status != 0:
        raise DvcError(f"python -m {module} ended with status {status}: {launched.stderr.strip()[-300:]}")
    return Usage(wall_s, cpu_s, peak_bytes)


def report_of(path: Path) -> dict[str, Any]:
    """Read the JSON report of a command."""
    values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return values
