"""Originals of an experiment: video files, and scenes that are rendered once into a cache."""

import json
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.environment import python_module
from dvc.files import lock
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.provenance import files_digest, input_digest, package_sources

_POLL_S = 0.2


@dataclass(frozen=True)
class Source:
    """One original."""

    name: str  # short name, for file names and reports
    path: Path  # video file or folder of images
    digest: str  # digest of the contents


def default_cache() -> Path:
    """Return the folder of rendered scenes."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dvc3d"


def find_source(sequence: str, cache: Path, processes: ProcessGroup) -> Source:
    """Return the original of a name or path; render a scene that the cache lacks."""
    entry = _catalogue(processes, "info", "--json", "--", sequence)
    if entry["path"] is not None:
        path = Path(entry["path"])
        return Source(source_name(path), path, input_digest(path))
    renderer = files_digest(package_sources("sequences"))
    path = cache / f"{entry['name']}-{renderer[:12]}.mkv"
    if not path.is_file():
        cache.mkdir(parents=True, exist_ok=True)
        _render(entry["name"], path, processes)
    return Source(entry["name"], path, input_digest(path))


def _render(scene: str, path: Path, processes: ProcessGroup) -> None:
    """Render a scene, or wait for another process that is rendering it."""
    lock_path = path.with_name(f".{path.name}.lock")
    with lock_path.open("w") as file:
        while True:
            try:
                lock(file.fileno())
                break
            except BlockingIOError:
                processes.pause(_POLL_S)
        if not path.is_file():
            processes.run(python_module("sequences", "render", scene, "--out", path))
        lock_path.unlink(missing_ok=True)


def check_source(sequence: str, processes: ProcessGroup) -> None:
    """Raise `DvcError` unless a name or path has an original."""
    _catalogue(processes, "info", "--json", "--", sequence)


def available_clips(processes: ProcessGroup) -> list[str]:
    """List the clips of the folder of video files."""
    return [entry["name"] for entry in _catalogue(processes, "list", "--json") if entry["kind"] == "file"]


def source_name(sequence: str | Path) -> str:
    """Return the short name of an original, without looking for it."""
    path = Path(sequence)
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", path.stem or path.name)[:60] or "video"


def _catalogue(processes: ProcessGroup, *arguments: str) -> Any:
    """Return the answer of the catalogue of sequences."""
    with tempfile.TemporaryFile() as output:
        processes.run(python_module("sequences", *arguments), output)
        output.seek(0)
        return json.load(output)
