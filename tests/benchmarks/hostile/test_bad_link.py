"""The bad link: its faults are of their kinds, and depend only on its seed."""

import pytest

from benchmarks.hostile.bad_link import FAULTS, Faults

DATA = bytes(range(256)) * 4


def passed(faults: Faults, times: int = 30) -> tuple[bytes, int]:
    """Return the bytes that pass, and the number of cuts."""
    out, cuts = b"", 0
    for _ in range(times):
        try:
            for piece in faults(DATA):
                out += piece
        except ConnectionError:
            cuts += 1
    return out, cuts


def test_a_good_link_changes_nothing() -> None:
    faults = Faults(1e15, seed=1)
    assert passed(faults) == (30 * DATA, 0)
    assert not any(faults.counts.values())


@pytest.mark.parametrize("kind", FAULTS)
def test_every_fault_is_what_it_says(kind: str) -> None:
    faults = Faults(1.0, seed=2, kinds=[kind])
    out, cuts = passed(faults)
    assert faults.counts == {kind: 30}
    assert cuts == (30 if kind == "cut" else 0)
    whole = 30 * DATA
    changed = {
        "cut": len(out) < len(whole),
        "flip": 0 < sum(a != b for a, b in zip(out, whole, strict=False)) <= 30,
        "drop": len(out) < len(whole),
        "repeat": len(out) > len(whole),
        "move": sorted(out) == sorted(whole) and out != whole,
        "trickle": out == whole,
    }
    assert changed[kind]


def test_faults_depend_on_the_seed() -> None:
    """Equal seeds give equal faults, so that a find can be repeated."""
    kinds = [kind for kind in FAULTS if kind != "trickle"]
    first, second, other = (passed(Faults(3000.0, seed, kinds)) for seed in (1, 1, 2))
    assert first == second != other
