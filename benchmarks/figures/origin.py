"""Where a row comes from: the code that measured it, and the kind of machine."""

import os
import platform
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

from benchmarks.figures.harness import Figure
from dvc.rd.provenance import values_digest
from dvc.rd.source_digest import Place, Sources

_CPU_INFO = Path("/proc/cpuinfo")


@cache
def machine() -> str:
    """Name the kind of this machine: what times depend on, and nothing that tells which one it is."""
    lines = _CPU_INFO.read_text(encoding="utf-8").splitlines() if _CPU_INFO.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{models[0] if models else platform.machine()}, {cores} {'core' if cores == 1 else 'cores'}"


def figure_digest(figure: Figure, sources: Sources) -> str:
    """Digest the code that a measurement runs, and what it is told."""
    places, told = list(_places(figure.measure)), list(_told(figure.measure))
    return values_digest([sources.digest([*places, *((name, "") for name in figure.programs)]), told])


def _places(measure: Callable[..., Any]) -> Iterator[Place]:
    if isinstance(measure, partial):
        yield from _places(measure.func)
        for value in (*measure.args, *measure.keywords.values()):
            if callable(value):
                yield from _places(value)
        return
    name = measure.__qualname__
    yield measure.__module__, name if name.isidentifier() else ""


def _told(measure: Callable[..., Any]) -> Iterator[str]:
    if isinstance(measure, partial):
        yield from _told(measure.func)
        for key, value in (*enumerate(measure.args), *sorted(measure.keywords.items())):
            yield from _told(value) if callable(value) else [f"{key}={value!r}"]
