"""Identity of the code as it is now, and the versions of libraries."""

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib import metadata, util
from pathlib import Path

CODEC = ("encoder", "decoder", "sfm", "dvc")
NOT_OF_THE_CODEC = ("contracts", "dibr", "images", "layers", "rd", "stereo")
"""Rooms of dvc that encoder and decoder do not import, by the contracts of `pyproject.toml`."""
_CODE = (".py", ".js", ".css", ".j2", ".vert", ".frag")
_LIBRARIES = ("av", "numba", "numpy", "opencv-python-headless", "scipy")


def codec_digest() -> str:
    """Digest the code of encoder and decoder as it is now; experiments are not part of it."""
    return packages_digest(CODEC, [f"dvc/{room}" for room in NOT_OF_THE_CODEC])


def packages_digest(packages: Iterable[str], without: Iterable[str] = ()) -> str:
    """Digest the names and contents of all files with code in packages, except in some of their folders."""
    digest = hashlib.sha256()
    for package in packages:
        spec = util.find_spec(package)
        if spec is None or spec.origin is None:
            continue
        folder = Path(spec.origin).parent
        skipped = [folder.parent / name for name in without]
        for path in sorted(folder.rglob("*")):
            if path.suffix in _CODE and not any(path.is_relative_to(name) for name in skipped):
                data = path.read_bytes()
                digest.update(f"{path.relative_to(folder.parent)}\0{len(data)}\0".encode())
                digest.update(data)
    return digest.hexdigest()[:32]


@cache
def library_versions() -> dict[str, str]:
    """List the libraries that take part in coding."""
    versions = {}
    for name in _LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions
