"""Memory of a process, as it is reported."""

import mmap
from pathlib import Path

import pytest

from dvc import memory
from dvc.memory import address_bytes, peak_resident_bytes, resident_bytes

SIZE = 64 << 20


def test_what_is_held_is_counted_and_the_peak_stays() -> None:
    """Pages that were written make the process larger; once they are gone, the peak is what it was."""
    before = resident_bytes()
    pages = mmap.mmap(-1, SIZE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)  # no heap that may have room
    for first in range(0, SIZE, mmap.PAGESIZE):
        pages[first] = 1
    held = resident_bytes()
    assert held - before > 0.9 * SIZE
    assert address_bytes() > held
    pages.close()
    assert resident_bytes() < held - 0.5 * SIZE
    assert peak_resident_bytes() > held - 0.1 * SIZE  # the system counts in rounds


def test_other_systems_tell_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without Linux's file of it all are 0."""
    monkeypatch.setattr(memory, "_STATUS", tmp_path / "none")
    assert resident_bytes() == peak_resident_bytes() == address_bytes() == 0
