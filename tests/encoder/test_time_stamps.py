"""Time stamps of sources: kept to the tick, whatever clock they have, and however it jumps."""

from collections.abc import Sequence
from fractions import Fraction
from itertools import accumulate, pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import VideoConfig
from dvc.stream import Deviations, frame_times_s
from dvc.video import Frame, TimeStamp
from encoder.encoder_session import CodingClock

LUMA = np.zeros((1, 1), np.uint8)
rates = st.sampled_from([Fraction(30000, 1001), Fraction(25), Fraction(15, 2), Fraction(16)])
clocks = st.sampled_from([1000, 90000, 600, 30000, 10**6])


def coded(
    clock: CodingClock, rate: Fraction, stamps: Sequence[TimeStamp | None], lengths: Sequence[int] = (3,)
) -> tuple[list[Fraction], list[Deviations | None]]:
    """Code frames in groups; return when a decoder shows them, and what was sent."""
    video = VideoConfig(1, 1, rate.numerator, rate.denominator)
    times_s: list[Fraction] = []
    sent = []
    while len(times_s) < len(stamps):
        group = stamps[len(times_s) : len(times_s) + lengths[len(sent) % len(lengths)]]
        deviations = clock.deviations([Frame(LUMA, time=stamp) for stamp in group])
        times_s += frame_times_s(video, len(times_s), len(group), deviations)
        sent.append(deviations)
    return times_s, sent


@given(
    rate=rates,
    clock=clocks,
    start=st.integers(-(10**9), 10**9),
    steps=st.lists(st.integers(1, 10**6), max_size=20),
    lengths=st.lists(st.integers(1, 5), min_size=1, max_size=4),
)
def test_times_come_back_to_the_tick(
    rate: Fraction, clock: int, start: int, steps: list[int], lengths: list[int]
) -> None:
    ticks = list(accumulate(steps, initial=start))
    stamps = [TimeStamp(tick, clock) for tick in ticks]
    times_s, sent = coded(CodingClock(rate), rate, stamps, lengths)
    assert all(after > before for before, after in pairwise(times_s))
    exact = [Fraction(tick - start, clock) for tick in ticks]
    assert all(abs(time_s - own_s) * clock < 1 for time_s, own_s in zip(times_s, exact, strict=True))
    if None not in sent:
        assert times_s == exact


@given(rate=rates, clock=clocks, count=st.integers(1, 40), start=st.integers(0, 1000))
def test_a_constant_rate_costs_nothing(rate: Fraction, clock: int, count: int, start: int) -> None:
    for rounded in (round, int):
        stamps = [TimeStamp(start + rounded(number / rate * clock), clock) for number in range(count)]
        assert set(coded(CodingClock(rate), rate, stamps)[1]) == {None}


@given(
    st.lists(st.none() | st.builds(TimeStamp, st.integers(-(2**60), 2**60), st.just(90000)), max_size=30),
    rates,
)
def test_any_clock_gives_frames_one_after_the_other(stamps: list[TimeStamp | None], rate: Fraction) -> None:
    """Times that are missing, go back or are years ahead leave a stream that a decoder takes."""
    times_s, _ = coded(CodingClock(rate), rate, stamps)
    assert all(after > before for before, after in pairwise(times_s))


def test_frames_without_times_follow_at_the_usual_distance() -> None:
    """As does the first one, where later ones have times; a clock that goes back goes on from there."""
    rate = Fraction(10)
    stamps = [None, *(TimeStamp(tick, 1000) for tick in (5000, 5100, 5350)), None, TimeStamp(0, 1000)]
    times_s, _ = coded(CodingClock(rate), rate, [*stamps, TimeStamp(120, 1000)])
    assert times_s == [Fraction(ms, 1000) for ms in (0, 100, 200, 450, 550, 650, 770)]
    assert coded(CodingClock(rate), rate, [None] * 5)[1] == [None, None]


def test_a_clock_that_is_too_coarse_tells_nothing() -> None:
    assert (
        coded(CodingClock(Fraction(10)), Fraction(10), [TimeStamp(n // 10, 1) for n in range(9)])[1]
        == [None] * 3
    )


def test_a_stream_goes_on_where_the_one_before_ended() -> None:
    """Its first frame is late by what it is later than a frame interval after the last."""
    rate = Fraction(10)
    clock = CodingClock(rate)
    clock.begin_stream()
    stamps = [TimeStamp(tick, 1000) for tick in (7000, 7150, 7200)]
    assert coded(clock, rate, stamps)[1] == [Deviations(1000, (0, 50, 0))]
    clock.begin_stream()
    stamps = [TimeStamp(tick, 1000) for tick in (7330, 7400, 7500)]
    assert coded(clock, rate, stamps)[1] == [Deviations(1000, (30, 0, 0))]
