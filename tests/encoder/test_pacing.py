"""Tests of falling behind a source, with clocks that are told what time it is."""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest

from dvc.video import Frame
from encoder.pacing import PacedFrames

FRAME = Frame(np.zeros((2, 2), np.uint8))


class Clock:
    """A clock that moves when it is told to."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def behind_s(work_s: list[float], waiting_s: float = 0.0, reading_s: float = 0.0) -> float:
    """Return how far work of given times on frames falls behind 4 of them a second."""
    clock, cpu_clock = Clock(), Clock()

    def source() -> Iterator[Frame]:
        for _ in work_s:
            clock.now_s += waiting_s + reading_s
            cpu_clock.now_s += reading_s
            yield FRAME

    frames = PacedFrames(source(), Fraction(4), clock, cpu_clock)
    for _, spent_s in zip(frames, work_s, strict=True):
        clock.now_s += spent_s
    return frames.behind_s


@pytest.mark.parametrize(
    ("work_s", "waiting_s", "reading_s", "expected_s"),
    [
        ([0.25] * 8, 0.0, 0.0, 0.0),
        ([0.5] * 9, 0.0, 0.0, 2.0),
        ([0.5] * 5 + [0.0] * 20, 0.0, 0.0, 1.25),
        ([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0], 0.0, 0.0, 1.0),
        ([0.125] * 8, 0.125, 0.0, 0.0),
        ([0.0] * 8, 5.0, 0.0, 0.0),
        ([0.25] * 9, 0.0, 0.25, 2.0),
        ([9.0], 0.0, 0.0, 0.0),
        ([], 0.0, 0.0, 0.0),
    ],
)
def test_lateness_adds_up_and_is_made_good(
    work_s: list[float], waiting_s: float, reading_s: float, expected_s: float
) -> None:
    """Work that takes longer than a frame lasts adds up; shorter work and waiting for the source take off."""
    assert behind_s(work_s, waiting_s, reading_s) == expected_s
