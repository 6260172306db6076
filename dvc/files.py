"""Files that appear complete or not at all, and files that keep what was finished of them."""

import errno
import io
import os
import secrets
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from dvc.errors import DvcError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

PARTIAL_SUFFIX = ".part"
_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_CANNOT_SYNC = frozenset({errno.EINVAL, errno.ENOSYS, errno.ENOTSUP})  # pipes and some file systems


class Closing(ABC):
    """What is closed at the end of a `with` block."""

    @abstractmethod
    def close(self) -> None:
        """Let go of what is held."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class SyncedFile(io.BufferedWriter):
    """A file to write from its beginning; what a write was given is on the disk when it returns."""

    def __init__(self, path: Path, mode: str = "w") -> None:
        super().__init__(io.FileIO(os.fspath(path), mode))

    def write(self, data: "ReadableBuffer") -> int:
        """Write bytes, and wait until the disk has them."""
        count = super().write(data)
        self.flush()
        try:
            os.fsync(self.fileno())
        except OSError as err:
            if err.errno not in _CANNOT_SYNC:
                raise
        return count

    def close(self) -> None:
        """Close the file; what a failed write left behind is dropped."""
        with suppress(OSError):
            super().close()


@contextmanager
def growing_output(path: Path) -> Iterator[SyncedFile]:
    """Give a new file to write to, ``path`` with ``.part`` after it; rename it to `path` on success."""
    partial = path.with_name(path.name + PARTIAL_SUFFIX)
    try:
        with SyncedFile(partial, "x") as file:
            _sync_folder(path.parent)
            yield file
        if path.exists():
            raise DvcError(f"cannot finish {path}: it exists; what was written is {partial}")
        os.rename(partial, path)
        _sync_folder(path.parent)
    except OSError as err:
        if _concerns(err, partial):
            raise DvcError(f"cannot write {partial}: {err.strerror}") from err
        raise


def _concerns(err: OSError, temporary: Path) -> bool:
    """Tell whether an error is about a file that is being written."""
    return err.errno in _NO_ROOM or str(temporary) in (err.filename, err.filename2)


def _sync_folder(folder: Path) -> None:
    """Wait until the disk has the names of a folder."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as err:
        if err.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)


def temporary_sibling(path: Path, error: type[DvcError] = DvcError, *, visible: bool = False) -> Path:
    """Create an empty file of a fresh name in the folder of `path`, from which it can be renamed into place.
    Create an empty file of a fresh name in the folder of `path`, from which it can be renamed into place.
    """
    if path.is_dir():
        raise error(f"cannot write {path}: it is a folder")
    if not path.parent.is_dir():
        raise error(f"cannot write {path}: the folder {path.parent} does not exist")
    fresh = f"{path.name[:100]}.{secrets.token_hex(4)}"
    temporary = path.with_name(f"{fresh}{PARTIAL_SUFFIX}" if visible else f".{fresh}.tmp")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as err:
        raise error(f"cannot write {path}: {err.strerror}") from err
    return temporary


@contextmanager
def atomic_output(path: str | Path, *, visible: bool = False) -> Iterator[Path]:
    """Give a temporary name to write to; rename it to `path` on success, remove it on any exception."""
    path = Path(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        yield path
        return
    target = Path(os.path.realpath(path))
    temporary = temporary_sibling(target, visible=visible)
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as err:
        if _concerns(err, temporary):
            raise DvcError(f"cannot write {path}: {err.strerror}") from err
        raise
    finally:
        with suppress(OSError):
            temporary.unlink()


def check_folder(path: str | Path) -> None:
    """Refuse a folder that `atomic_folder` would refuse, before any work is done."""
    target = Path(path)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise DvcError(f"cannot write {target}: it exists and is not an empty folder")
    if not target.absolute().parent.is_dir():
        raise DvcError(f"cannot write {target}: the folder {target.parent} does not exist")


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Give a temporary folder that is renamed to `path` on success and removed on any exception."""
    target = Path(path)
    check_folder(target)
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}.tmp")
    try:
        temporary.mkdir()
    except OSError as err:
        raise DvcError(f"cannot write {target}: {err.strerror}") from err
    try:
        yield temporary
        if target.exists():
            target.rmdir()
        temporary.rename(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def same_file(a: str | Path, b: str | Path) -> bool:
    """Tell whether two names lead to one file, through links as well."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return os.path.realpath(a) == os.path.realpath(b)
