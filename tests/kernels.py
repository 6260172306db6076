"""Compiled kernels, kept from one clone to the next: `python -m tests.kernels {fetch,keep}`.

Machine code holds as long as its sources read the same (see `dvc._jit`), wherever the tree lies. `fetch`
takes what an earlier clone has kept; `keep` puts what is there now beside it, in `DVC_KERNELS` or the user's
cache folder.
"""

import fcntl
import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("dvc", "decoder", "encoder", "sequences", "sfm")
MAX_AGE_S = 14 * 24 * 3600.0
"""What was compiled before is not kept: it may be of sources that are no more."""


@contextmanager
def kept() -> Iterator[Path]:
    """Return where kernels are kept, for one process at a time."""
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("DVC_KERNELS") or Path(caches) / "dvc3d" / "kernels")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield folder


def kernels(root: Path) -> Iterator[Path]:
    """List files of compiled kernels, relative to a root."""
    for package in PACKAGES:
        for path in (root / package).rglob("*.nb[ic]"):
            yield path.relative_to(root)


def fetch() -> None:
    """Take what is kept, where nothing was compiled yet."""
    with kept() as folder:
        if not any(kernels(ROOT)):
            _copy(folder, ROOT)


def keep() -> None:
    """Keep what was compiled lately, and nothing else."""
    with kept() as folder:
        for package in PACKAGES:
            shutil.rmtree(folder / package, ignore_errors=True)
        _copy(ROOT, folder)


def _copy(source: Path, target: Path) -> None:
    for path in kernels(source):
        if (source / path).stat().st_mtime > time.time() - MAX_AGE_S:
            (target / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source / path, target / path)


if __name__ == "__main__":
    {"fetch": fetch, "keep": keep}[sys.argv[1]]()
