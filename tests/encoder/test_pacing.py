"""Tests of falling behind a source, with clocks that are told what time it is."""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest

from dvc.video import Frame
from encoder.pacing import DecoderPace, PacedFrames

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


def test_a_late_decoder_is_told_of_less_and_less_often() -> None:
    """It is said when the decoder is a second late, and when it is four times as late as was said last."""
    clock, said = Clock(), list[str]()
    pace = DecoderPace(Fraction(4), said.append, clock=clock)
    pace.waits()
    for _ in range(3):
        pace.sent(8)
    pace.done(8)
    for now_s in range(40):
        clock.now_s = float(now_s)
        pace.waits()
    assert [line.split(" s behind")[0] for line in said] == [
        f"the decoder is {late}.0" for late in (1, 4, 16)
    ]
    assert "16 frames up to number 23" in said[0]
    assert "others wait; none left out" in said[0]
    assert (pace.behind_s, pace.most_frames_open) == (33.0, 24)


def test_a_decoder_in_time_is_not_told_of() -> None:
    """As long as frames are sent as early as they come nothing is said."""
    clock, said = Clock(), list[str]()
    pace = DecoderPace(Fraction(4), said.append, clock=clock)
    for number in range(50):
        clock.now_s = 0.25 * number
        pace.sent(1)
        pace.waits()
        pace.done(1)
    assert (said, pace.behind_s, pace.most_frames_open) == ([], 0.0, 1)
