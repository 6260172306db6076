"""What coding rests on: the code as it is now, and the versions of libraries."""

from functools import cache
from importlib import metadata

from dvc.source_digest import Sources

_LIBRARIES = ("av", "numba", "numpy", "opencv-python-headless", "scipy")


def codec_digest() -> str:
    """Digest the code of encoder and decoder as it is now; experiments are no part of it."""
    return Sources().digest([("encoder", ""), ("decoder", "")])


@cache
def library_versions() -> dict[str, str]:
    """List the libraries that take part in coding."""
    versions = {}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions
