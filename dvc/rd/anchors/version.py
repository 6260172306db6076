"""Version of what runs the anchors; it does not change with the codec."""

from functools import cache
from importlib import metadata

from dvc.rd.provenance import files_digest, package_sources, values_digest


@cache
def anchors_digest() -> str:
    """Digest the sources of this package and the version of PyAV, which brings the encoders."""
    return values_digest([files_digest(package_sources(__package__)), metadata.version("av")])
