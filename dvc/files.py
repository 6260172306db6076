"""Output files that appear complete or not at all, and files that keep their finished parts."""

import errno
import fcntl
import io
import os
import re
import secrets
import shutil
import stat
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Self

from dvc.errors import DvcError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

PARTIAL_SUFFIX = ".part"
MAX_NAME_BYTES = 200
"""Longest file name that is not shortened while the file is written under a longer name."""
MAX_ENDLESS_BYTES = 1 << 26
"""Largest content that is read from a pipe or a device, which may never end."""
_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_CANNOT_LOCK = frozenset({errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP})  # some network file systems
_CANNOT_SYNC = frozenset({errno.EINVAL, errno.ENOSYS, errno.ENOTSUP})  # pipes and some file systems


class Closing(ABC):
    """Object that a `with` block closes."""

    @abstractmethod
    def close(self) -> None:
        """Release the resources."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class SyncedFile(io.BufferedWriter):
    """A new file; each write returns when the file or, if `waits`, the disk has the data."""

    def __init__(self, path: Path, mode: str = "w", *, waits: bool = True) -> None:
        super().__init__(io.FileIO(os.fspath(path), mode))
        self._waits = waits

    def write(self, data: "ReadableBuffer") -> int:
        """Write bytes, and wait until the file or the disk has them."""
        count = super().write(data)
        self.flush()
        if not self._waits:
            return count
        try:
            os.fsync(self.fileno())
        except OSError as err:
            if err.errno not in _CANNOT_SYNC:
                raise
        return count

    def close(self) -> None:
        """Close the file; drop the rest of a failed write."""
        with suppress(OSError):
            super().close()


@contextmanager
def growing_output(path: Path) -> Iterator[SyncedFile]:
    """Open a new file, ``path`` with ``.part`` after it; rename it to `path` on success."""
    partial = path.with_name(path.name + PARTIAL_SUFFIX)
    try:
        with SyncedFile(partial, "x") as file:
            sync(path.parent)
            yield file
        if path.exists():
            raise DvcError(f"cannot finish {path}: it exists; the written data are in {partial}")
        os.rename(partial, path)
        sync(path.parent)
    except OSError as err:
        if _concerns(err, partial):
            raise DvcError(f"cannot write {partial}: {err.strerror}") from err
        raise


def _concerns(err: OSError, temporary: Path) -> bool:
    """Return whether an error is about an unfinished file or folder."""
    return err.errno in _NO_ROOM or any(
        str(name).startswith(str(temporary)) for name in (err.filename, err.filename2)
    )


def read_whole(path: str | Path) -> bytes:
    """Read a whole file; a pipe or a device up to a limit."""
    with open(path, "rb") as file:
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            return file.read()
        content = file.read(MAX_ENDLESS_BYTES + 1)
    if len(content) > MAX_ENDLESS_BYTES:
        raise DvcError(f"{path}: not a file, and more than {MAX_ENDLESS_BYTES >> 20} MiB")
    return content


def natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Return a sort key that compares numbers in names by value: ``2.png`` before ``10.png``."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts]


def sync(path: Path) -> None:
    """Wait until the disk has a file, or the entries of a folder."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError as err:
        if err.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)


class OutputFile:
    """A file that is written under another name in its folder, locked against other writers.

    The other name is hidden, or visible (`path` with ``.part`` after it) if partial data are useful; those of
    an earlier run are then renamed.
    """

    def __init__(self, path: str | Path, error: type[DvcError] = DvcError, *, visible: bool = False) -> None:
        self._named, self._error = path, error
        self._target = Path(os.path.realpath(path))
        name = self._target.name
        if self._target.is_dir():
            raise error(f"cannot write {path}: it is a folder")
        if not self._target.parent.is_dir():
            raise error(f"cannot write {path}: the folder {self._target.parent} does not exist")
        self.partial = self._target.with_name(name + PARTIAL_SUFFIX)
        if len(os.fsencode(name)) > MAX_NAME_BYTES:
            name = f"{name[: MAX_NAME_BYTES // 8]}.{zlib.crc32(os.fsencode(name)):08x}"
        self.temporary = self.partial if visible else self._target.with_name(f".{name}.tmp")
        with self.naming():
            self._descriptor = self._locked()

    def _locked(self) -> int:
        """Create the temporary file and lock it; the lock ends with the process."""
        while True:
            descriptor = os.open(self.temporary, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
            try:
                lock(descriptor)
                status = os.fstat(descriptor)
                with suppress(FileNotFoundError):  # another program has renamed or removed it since
                    if os.path.samestat(status, self.temporary.stat()):
                        if self.temporary != self.partial or status.st_size == 0:
                            os.ftruncate(descriptor, 0)
                            return descriptor
                        names = (f"{self.partial.stem}.{n}{PARTIAL_SUFFIX}" for n in count(1))
                        paths = (self.partial.with_name(name) for name in names)
                        self.partial.rename(next(path for path in paths if not path.exists()))
            except BlockingIOError:
                os.close(descriptor)
                raise self._error(f"cannot write {self._named}: another program is writing it") from None
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Name the file in errors of the system that concern it."""
        try:
            yield
        except OSError as err:
            if _concerns(err, self.temporary):
                raise self._error(f"cannot write {self._named}: {err.strerror}") from err
            raise

    def commit(self, *, partial: bool = False) -> None:
        """Rename the file into place, or to the visible name of partial data, once the disk has it."""
        name = self.partial if partial else self._target
        with self.naming():
            sync(self.temporary)
            os.replace(self.temporary, name)
            sync(name.parent)
        self._release()

    def discard(self) -> None:
        """Remove the file, unless it has been renamed."""
        if self._descriptor >= 0:
            with suppress(OSError):
                self.temporary.unlink()
            self._release()

    def _release(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        os.close(descriptor)


def lock(descriptor: int) -> None:
    """Lock a file until it is closed; `BlockingIOError` if another program has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as err:
        if err.errno not in _CANNOT_LOCK:
            raise


@contextmanager
def atomic_output(path: str | Path, *, visible: bool = False, kept: bool = False) -> Iterator[Path]:
    """Yield a temporary path; rename it to `path` on success, remove it on any exception.

    If `kept`, the temporary name is visible, and the file stays on an exception unless it is empty.
    """
    path = Path(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        yield path
        return
    output = OutputFile(path, visible=visible or kept)
    try:
        with output.naming():
            yield output.temporary
        output.commit()
    except BaseException:
        if kept and output.temporary.stat().st_size > 0:
            output.commit(partial=True)
        raise
    finally:
        output.discard()


def check_folder(path: str | Path) -> None:
    """Refuse a folder that `atomic_folder` would refuse, before any work is done."""
    target = Path(path)
    if target.name in ("", ".."):
        raise DvcError(f"cannot write {target}: it has no name; a new folder in it has one")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise DvcError(f"cannot write {target}: it exists and is not an empty folder")
    if not target.absolute().parent.is_dir():
        raise DvcError(f"cannot write {target}: the folder {target.parent} does not exist")


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder; rename it to `path` on success, remove it on any exception."""
    target = Path(path)
    check_folder(target)
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}.tmp")
    try:
        temporary.mkdir()
        yield temporary
        if target.exists():
            target.rmdir()
        temporary.rename(target)
    except OSError as err:
        if _concerns(err, temporary):
            raise DvcError(f"cannot write {target}: {err.strerror}") from err
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def same_file(a: str | Path, b: str | Path) -> bool:
    """Return whether two paths refer to one file, also through links."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return os.path.realpath(a) == os.path.realpath(b)
