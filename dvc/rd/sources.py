"""Originals of an experiment: files as they are, rendered scenes rendered once into a cache."""

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from dvc.rd.processes import ProcessGroup
from dvc.rd.provenance import files_digest, input_digest, package_sources


@dataclass(frozen=True)
class Source:
    """One original.

    Attributes
    ----------
    name : str
        Short name, for file names and reports.
    path : Path
        Video file or folder of images.
    digest : str
        Of its contents.
    """

    name: str
    path: Path
    digest: str


def default_cache() -> Path:
    """Return the folder of rendered scenes.

    Returns
    -------
    Path
        ``$XDG_CACHE_HOME/dvc3d``, or ``~/.cache/dvc3d``.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dvc3d"


def find_source(sequence: str, cache: Path, processes: ProcessGroup) -> Source:
    """Find the original that a name stands for; a rendered scene is rendered if the cache lacks it.

    Parameters
    ----------
    sequence : str
        Name of the catalogue, or a path.
    cache : Path
        Folder of rendered scenes, made if needed.
    processes : ProcessGroup
        Runs the renderer.

    Returns
    -------
    Source
        The original.

    Raises
    ------
    DvcError
        If there is no such sequence, or it cannot be rendered.
    """
    from sequences import catalogue

    found = catalogue.resolve(sequence)
    if isinstance(found, Path):
        return Source(_short_name(found), found, input_digest(found))
    path = cache / f"{found.name}-{_renderer_digest()[:12]}.mkv"
    if not path.is_file():
        cache.mkdir(parents=True, exist_ok=True)
        processes.run([sys.executable, "-m", "sequences", "render", found.name, "--out", str(path)])
    return Source(found.name, path, input_digest(path))


def source_name(sequence: str) -> str:
    """Return the short name of what a name stands for, without looking for it.

    Parameters
    ----------
    sequence : str
        Name of the catalogue, or a path.

    Returns
    -------
    str
        As in `Source`.
    """
    return _short_name(Path(sequence))


def _renderer_digest() -> str:
    import sequences

    return files_digest(package_sources(Path(sequences.__file__).parent))


def _short_name(path: Path) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", path.stem or path.name)[:60] or "video"
