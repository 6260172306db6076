"""Memory of this process, as Linux counts it."""

from pathlib import Path

_STATUS = Path("/proc/self/status")


def resident_bytes() -> int:
    """Return the memory that this process holds now."""
    return _field("VmRSS:")


def peak_resident_bytes() -> int:
    """Return the largest memory that this process has held since its program was loaded."""
    return _field("VmHWM:")


def address_bytes() -> int:
    """Return the size of the address space of this process, which a limit of memory counts."""
    return _field("VmSize:")


def _field(name: str) -> int:
    try:
        lines = _STATUS.read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return 1024 * next((int(line.split()[1]) for line in lines if line.startswith(name)), 0)
