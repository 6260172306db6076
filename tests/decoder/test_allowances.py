"""What frames may ask for, where an encoder keeps a bitrate."""

import pytest

from decoder.allowances import Allowance, GroupAllowance


def bits_of(group: GroupAllowance, *frames: int) -> list[float]:
    return [allowance.bits for allowance in group.begin_level(frames)]


def test_planes_begin_as_long_as_there_is_room_for_them() -> None:
    """What they were expected to cost counts until it is known what they did."""
    allowance = Allowance(1032.0)  # two checks of 16 bits are kept back
    assert allowance.begin(600.0)
    assert not allowance.begin(600.0)
    assert allowance.begin(400.0)
    allowance.end(600.0, 300)
    assert allowance.begin(300.0)
    assert not allowance.begin(1.0)
    allowance.end(400.0, 700)
    assert not allowance.begin(0.0)
    assert Allowance().begin(1e12)


def test_what_is_left_goes_to_later_frames() -> None:
    """Level by level, in the parts that the encoder tells; the last may ask for all of it."""
    group = GroupAllowance({8: 400, 4: 200, 12: 200, 2: 100, 6: 100})
    assert bits_of(group, 8) == [pytest.approx(1.25 * 400)]
    group.end_level(200)  # of 1000 800 are left, for frames of which 600 was told
    assert bits_of(group, 4, 12) == [pytest.approx(1.25 * 800 / 3)] * 2
    group.end_level(700)
    assert bits_of(group, 2, 6) == [pytest.approx(50.0)] * 2


def test_a_level_never_has_more_than_is_left() -> None:
    """However much of a group it is, and however much was asked for before."""
    assert bits_of(GroupAllowance({1: 900, 2: 50}), 1) == [pytest.approx(950.0)]
    group = GroupAllowance({1: 100, 2: 100})
    group.begin_level([1])
    group.end_level(300)
    assert bits_of(group, 2) == [0.0]
    assert bits_of(GroupAllowance({1: 0, 2: 0}), 1) == [0.0]


def test_without_a_bitrate_nothing_is_limited() -> None:
    """Frames may ask for what they need."""
    group = GroupAllowance(None)
    assert [allowance.bits for allowance in group.begin_level([3, 5])] == [float("inf")] * 2
    group.end_level(10**9)
    assert group.begin_level([4])[0].begin(10.0**9)
