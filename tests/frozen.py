"""Frozen streams: what a release has frozen stays, to the byte, and is decoded by all that follow."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dvc import __version__

GOLDEN = Path(__file__).resolve().parent / "golden"
DIGESTS = {
    ("streams", "2.0.0.dev0"): "20e6068dc536edf92ccc8568e33f08c5069da1449110733a470140ad6b4d0279",
    ("dibr", "1.0.0"): "4bba846de6506f032fe73c6822ac4d662f783c42b2b78cb2e6513214fee14341",
}
"""Of the records of what a release has frozen in a folder: a line that is here is never changed."""
Records = dict[str, dict[str, Any]]


def _path(folder: Path, release: str) -> Path:
    return folder / f"records-{release}.json"


def records(folder: Path) -> Records:
    """Return what is frozen of every stream in a folder, by any release."""
    found: Records = {}
    for path in sorted(folder.glob("records-*.json")):
        found |= json.loads(path.read_text())
    return found


def missing(folder: Path, names: Iterable[str]) -> list[str]:
    """Return which of these are not frozen yet."""
    frozen = records(folder)
    return [name for name in names if name not in frozen]


def freeze(folder: Path, new: Records) -> None:
    """Add records of this release."""
    path = _path(folder, __version__)
    found: Records = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(json.dumps(dict(sorted((found | new).items())), indent=1) + "\n")


def digest(folder: Path, release: str) -> str:
    """Return the digest of the records of what a release has frozen."""
    return hashlib.sha256(_path(folder, release).read_bytes()).hexdigest()
