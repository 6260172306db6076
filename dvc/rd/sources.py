"""Originals of an experiment: files as they are, rendered scenes rendered once into a cache."""

import json
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.environment import python_module
from dvc.files import lock
from dvc.rd.processes import ProcessGroup
from dvc.rd.provenance import files_digest, input_digest, package_sources

_PATIENCE_S = 0.2


@dataclass(frozen=True)
class Source:
    """One original."""

    name: str  # short name, for file names and reports
    path: Path  # video file or folder of images
    digest: str  # of its contents


def default_cache() -> Path:
    """Return the folder of rendered scenes."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dvc3d"


def find_source(sequence: str, cache: Path, processes: ProcessGroup) -> Source:
    """Find the original that a name stands for; a rendered scene is rendered if the cache lacks it."""
    entry = _ask(processes, "info", "--json", "--", sequence)
    if entry["path"] is not None:
        found = Path(entry["path"])
        return Source(_short_name(found), found, input_digest(found))
    renderer = files_digest(package_sources("sequences"))
    path = cache / f"{entry['name']}-{renderer[:12]}.mkv"
    if not path.is_file():
        cache.mkdir(parents=True, exist_ok=True)
        _render(entry["name"], path, processes)
    return Source(entry["name"], path, input_digest(path))


def _render(scene: str, path: Path, processes: ProcessGroup) -> None:
    """Render a scene, or wait for the program that is rendering it."""
    guard = path.with_name(f".{path.name}.lock")
    with guard.open("w") as file:
        while not _locks(file.fileno()):
            processes.pause(_PATIENCE_S)
        if not path.is_file():
            processes.run(python_module("sequences", "render", scene, "--out", path))
        guard.unlink(missing_ok=True)


def _locks(descriptor: int) -> bool:
    try:
        lock(descriptor)
    except BlockingIOError:
        return False
    return True


def check_source(sequence: str, processes: ProcessGroup) -> None:
    """Refuse a name that no original has."""
    _ask(processes, "info", "--json", "--", sequence)


def available_clips(processes: ProcessGroup) -> list[str]:
    """List the clips of the folder of video files."""
    return [entry["name"] for entry in _ask(processes, "list", "--json") if entry["kind"] == "file"]


def source_name(sequence: str) -> str:
    """Return the short name of what a name stands for, without looking for it."""
    return _short_name(Path(sequence))


def _ask(processes: ProcessGroup, *arguments: str) -> Any:
    """Return what the catalogue says."""
    with tempfile.TemporaryFile() as output:
        processes.run(python_module("sequences", *arguments), output)
        output.seek(0)
        return json.load(output)


def _short_name(path: Path) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", path.stem or path.name)[:60] or "video"
