"""What waits in memory and in a file: in order, bounded, and gone at the end."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dvc.errors import DvcError
from encoder.spool import Spool

MEMORY_BYTES, FILE_BYTES = 100, 1000


def test_all_comes_in_order_from_memory_and_file(tmp_path: Path) -> None:
    """However often the file has been gone round; it has no name meanwhile, and bounds hold."""
    rng = np.random.default_rng(5)
    waiting: list[bytes] = []
    with Spool(str(tmp_path / "spool"), FILE_BYTES, MEMORY_BYTES) as held:
        assert list(tmp_path.iterdir()) == []
        for _ in range(2000):
            if held.has_room and rng.random() < 0.6:
                waiting.append(rng.bytes(int(rng.integers(1, 90))))
                held.put(waiting[-1])
            elif waiting:
                assert held.take() == waiting.pop(0)
            assert os.fstat(held._file).st_size <= FILE_BYTES
        while waiting:
            assert held.take() == waiting.pop(0)
        assert os.fstat(held._file).st_size == 0
        assert MEMORY_BYTES / 2 < held.report.most_in_memory < 2 * MEMORY_BYTES
        assert FILE_BYTES / 2 < held.report.most_on_disk <= FILE_BYTES


def test_there_is_room_until_memory_and_file_are_full(tmp_path: Path) -> None:
    """For as much as came at a time before."""
    with Spool(str(tmp_path / "spool"), FILE_BYTES, MEMORY_BYTES) as held:
        count = 0
        while held.has_room:
            held.put(bytes(50))
            count += 1
        assert count == (MEMORY_BYTES + FILE_BYTES) // 50
        held.put(bytes(50))  # all the same: in memory
        assert held.report.most_in_memory == MEMORY_BYTES + 50
        assert held.take() == bytes(50)
        assert not held.has_room
        held.take()
        assert held.has_room


def failing(*results: Exception | int) -> Callable[..., int]:
    """Return what stands in for a write of the system."""
    outcomes = iter(results)

    def write(*_: object) -> int:
        outcome = next(outcomes)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    return write


def test_a_disk_that_is_full_takes_nothing_any_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is said once; what waits comes all the same, and memory alone has room."""
    said: list[str] = []
    with Spool(str(tmp_path / "spool"), FILE_BYTES, MEMORY_BYTES, said.append) as held:
        for byte in b"abc":
            held.put(bytes([byte]) * 60)
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        monkeypatch.setattr(os, "pwrite", failing(20, full))
        held.put(b"d" * 60)
        assert said == [f"cannot spool to {tmp_path}/spool any more: No space left on device"]
        assert held.report.failure == "No space left on device"
        assert not held.has_room
        assert [held.take() for _ in range(4)] == [bytes([byte]) * 60 for byte in b"abcd"]
        assert held.has_room
        held.put(b"e" * 60)
        assert held.take() == b"e" * 60


def test_a_file_that_has_lost_something_is_told(tmp_path: Path) -> None:
    """Whoever has cut it short."""
    with Spool(str(tmp_path / "spool"), FILE_BYTES, MEMORY_BYTES) as held:
        held.put(bytes(120))
        os.ftruncate(held._file, 7)
        with pytest.raises(DvcError, match=r"what was spooled to .*spool is gone"):
            held.take()


def test_files_that_cannot_be_made_are_refused(tmp_path: Path) -> None:
    """What is there stays as it is."""
    (tmp_path / "there").write_bytes(b"precious")
    for name, reason in (("there", "File exists"), ("none/spool", "No such file"), (".", "File exists|Is a")):
        with pytest.raises(DvcError, match=rf"cannot spool to .*: ({reason})"):
            Spool(str(tmp_path / name), FILE_BYTES, MEMORY_BYTES)
    assert (tmp_path / "there").read_bytes() == b"precious"
