"""Bitrates are kept whatever groups take, as far as there are qualities that keep them."""

import math
from fractions import Fraction
from itertools import accumulate

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import ConfigError
from encoder.rate_control.bitrate import (
    MAX_RISE,
    START_S,
    STEPS,
    TOLERANCE,
    WINDOW_S,
    BitrateController,
    QualityStep,
    RateLimits,
    keep_within,
)

BITS_PER_S, FRAME_RATE = 300_000, Fraction(30)
LENGTHS = st.lists(st.integers(4, 16), min_size=12, max_size=40)


def number_of(quality: QualityStep) -> float:
    return quality.qp + quality.coarser_share


def group_bits(quality: QualityStep, num_frames: int, complexity: float) -> int:
    """Return what a made-up group takes: 16 % less with each QP."""
    return round(complexity * num_frames * 10_000 * 2.0 ** (0.25 * (30.0 - number_of(quality))))


def deviations(lengths: list[int], bits: list[float]) -> list[float]:
    """Return by how much groups that last as long as the window are off, but those of the first one."""
    times = [frames / FRAME_RATE for frames in accumulate(lengths, initial=0)]
    sums = list(accumulate(bits, initial=0.0))
    found = []
    for first in range(len(times)):
        last = next((n for n in range(first, len(times)) if times[n] - times[first] >= WINDOW_S), None)
        if times[first] >= WINDOW_S and last is not None:
            wanted = BITS_PER_S * float(times[last] - times[first])
            found.append((sums[last] - sums[first]) / wanted - 1.0)
    return found


@settings(max_examples=50)
@given(LENGTHS, st.randoms(use_true_random=False))
def test_a_window_has_its_bitrate(lengths: list[int], random: st.DataObject) -> None:
    """Groups differ by up to an octave; no window is off by more than is allowed."""
    controller, bits = BitrateController(BITS_PER_S, FRAME_RATE), []
    for length in lengths:
        complexity = 2.0 ** random.uniform(-0.5, 0.5)  # type: ignore[attr-defined]
        quality = controller.choose(length, lambda q, n=length, c=complexity: (group_bits(q, n, c), 0.0))
        bits.append(float(group_bits(quality, length, complexity)))
    assert all(abs(off) <= TOLERANCE for off in deviations(lengths, bits))
    assert controller.most_owed <= (START_S + TOLERANCE) * BITS_PER_S * 1.01


def test_quality_stays_where_it_may() -> None:
    """Groups that take their share at the quality of the one before have it."""
    controller = BitrateController(BITS_PER_S, FRAME_RATE)
    controller.choose(1, lambda _: (160_000, 0.0))
    found = [controller.choose(16, lambda _: (161_000, 0.0)) for _ in range(5)]
    assert len(set(found)) == 1


def test_a_new_scene_is_paid_for_later() -> None:
    """One group does not become much coarser; those after it take less until nothing is owed."""
    controller, numbers, complexities = BitrateController(BITS_PER_S, FRAME_RATE), [], [1.0] * 40
    complexities[10] = 30.0
    owed = []
    for complexity in complexities:
        quality = controller.choose(8, lambda q, c=complexity: (group_bits(q, 8, c), 0.0))
        numbers.append(number_of(quality))
        owed.append(controller.owed)
    assert numbers[10] - numbers[9] == MAX_RISE / STEPS
    assert owed[10] > 10 * abs(owed[9])
    assert abs(owed[-1]) <= 0.5 * TOLERANCE * WINDOW_S * BITS_PER_S


def test_what_decoders_ask_for_is_learnt() -> None:
    """Where they take half of what is estimated, later groups are expected to; errors are made up for."""
    controller, lengths, bits = BitrateController(BITS_PER_S, FRAME_RATE), [16] * 40, []
    for number, length in enumerate(lengths):
        quality = controller.choose(length, lambda q: (2000, float(2 * group_bits(q, 16, 1.0))))
        asked = group_bits(quality, 16, 1.0)
        controller.settle(number, asked)
        bits.append(2000.0 + asked)
    assert all(abs(off) <= TOLERANCE for off in deviations(lengths, bits)[4:])
    controller.settle(10**6, 0)  # a group of which nothing was estimated


def test_steps_of_quality_begin_with_frames_that_predict_none() -> None:
    """Those with the nearest references are the first to be coarser."""
    distances = [2, 4, 2, 16, 2, 4, 2, 8]
    assert QualityStep.of(30 * STEPS).qps(distances) == [30] * 8
    half = QualityStep.of(30 * STEPS + STEPS // 2).qps(distances)
    assert half == [31, 30, 31, 30, 31, 30, 31, 30]
    assert QualityStep(51, 0.5).qps(distances) == [51] * 8


def test_frames_are_coded_coarser_until_they_fit() -> None:
    """As far as there are coarser ones."""
    tried: list[int] = []

    def bits(coarser: int) -> float:
        tried.append(coarser)
        return 8000 * 2.0 ** (-coarser / 6)

    assert keep_within(8000, bits)
    assert tried == [0]
    assert keep_within(2000, bits)
    assert 12 <= tried[-1] <= 18
    assert not keep_within(1, bits)
    assert tried[-1] >= 50
    assert keep_within(math.inf, bits)


@pytest.mark.parametrize("limits", [(0, None), (None, 0), (-5, 7)])
def test_limits_that_make_no_sense_are_refused(limits: tuple[int | None, int | None]) -> None:
    """There is no rate of nothing."""
    with pytest.raises(ConfigError, match="must be from 1 to"):
        RateLimits(*limits)
