"""Originals of an experiment, scenes that are rendered once into a cache, and the version of the code."""

import hashlib
import json
import os
import re
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import dvc
from dvc.environment import child_environment, python_module
from dvc.files import lock
from dvc.rd.child_processes import ProcessGroup
from dvc.versions import CODEC, codec_digest, packages_digest

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
    entry = catalogue(processes, "info", "--json", "--", sequence)
    if entry["path"] is not None:
        path = Path(entry["path"])
        return Source(source_name(path), path, input_digest(path))
    path = cache / f"{entry['name']}-{packages_digest(['sequences'])[:12]}.mkv"
    if not path.is_file():
        cache.mkdir(parents=True, exist_ok=True)
        lock_path = path.with_name(f".{path.name}.lock")
        with lock_path.open("w") as file:
            while True:
                try:
                    lock(file.fileno())
                    break
                except BlockingIOError:  # another process is rendering the scene
                    processes.pause(_POLL_S)
            if not path.is_file():
                processes.run(python_module("sequences", "render", entry["name"], "--out", path))
            lock_path.unlink(missing_ok=True)
    return Source(entry["name"], path, input_digest(path))


def source_name(sequence: str | Path) -> str:
    """Return the short name of an original, without looking for it."""
    path = Path(sequence)
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", path.stem or path.name)[:60] or "video"


def catalogue(processes: ProcessGroup, *arguments: str) -> Any:
    """Return the answer of the catalogue of sequences."""
    with tempfile.TemporaryFile() as output:
        processes.run(python_module("sequences", *arguments), output)
        output.seek(0)
        return json.load(output)


@dataclass(frozen=True)
class CodeVersion:
    """Version of the codec, or source of an imported point."""

    version: str  # version of the distribution
    digest: str  # digest of the code of the codec
    # commit of the repository that tracks the code, with ``-dirty`` if a package of the codec was changed
    commit: str | None = None


@cache
def code_version() -> CodeVersion:
    """Return the version of the code that would run."""
    return CodeVersion(version=dvc.__version__, commit=_commit(Path(dvc.__file__)), digest=codec_digest())


@cache
def anchors_digest() -> str:
    """Digest the sources that run the anchors and the version of PyAV, which brings their encoders."""
    return values_digest([packages_digest(["dvc.rd.anchors"]), metadata.version("av")])


def input_digest(path: Path) -> str:
    """Digest the contents of a video file, or names and contents of a folder of images."""
    if path.is_dir():
        digest = hashlib.sha256()
        for file in sorted(entry for entry in path.iterdir() if entry.is_file()):
            digest.update(f"{path.name}/{file.name}\0{file.stat().st_size}\0".encode())
            digest.update(file.read_bytes())
        return digest.hexdigest()[:32]
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()[:32]


def values_digest(values: object) -> str:
    """Digest JSON-safe values."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _commit(source: Path) -> str | None:
    """Return the commit of the repository that tracks a source file, or None without one or without git."""
    folder = source.parent
    try:
        if _git(folder, "ls-files", "--error-unmatch", source.name) is None:
            return None
        commit = _git(folder, "rev-parse", "--short=12", "HEAD")
        changed = _git(folder.parent, "status", "--porcelain", "--", *CODEC)
    except OSError:
        return None
    return commit if not (commit and changed) else f"{commit}-dirty"


def _git(folder: Path, *command: str) -> str | None:
    """Return the output of git, or None if it fails; the repository may not name a program to run."""
    words = ["git", "-c", "core.fsmonitor=false", "-C", str(folder), *command]
    done = subprocess.run(words, env=child_environment(), capture_output=True, check=False, text=True)
    return done.stdout.strip() if done.returncode == 0 else None
