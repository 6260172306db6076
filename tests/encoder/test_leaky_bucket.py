"""Bitrates are kept whatever groups take, as far as there are qualities that keep them."""

from collections import deque
from fractions import Fraction
from itertools import accumulate

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import ConfigError
from dvc.slepian_wolf.requests import drive
from encoder.leaky_bucket import (
    ASKED_BPP,
    ASKED_OCTAVES_PER_QP,
    DEMAND_MARGIN,
    MAX_RISE,
    START_S,
    STEPS,
    ExpectedBits,
    LeakyBucket,
    QualitySearch,
    QualityStep,
    coarser_qp,
    forecast,
)
from encoder.rate_limits import TOLERANCE, WINDOW_S, RateLimits

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
    bucket, bits = LeakyBucket(BITS_PER_S, FRAME_RATE), []
    for length in lengths:
        complexity = 2.0 ** random.uniform(-0.5, 0.5)  # type: ignore[attr-defined]
        quality = drive(
            bucket.choose(length), lambda q, n=length, c=complexity: ExpectedBits(group_bits(q, n, c))
        )
        bits.append(float(group_bits(quality, length, complexity)))
    assert all(abs(off) <= TOLERANCE for off in deviations(lengths, bits))
    assert bucket.peak_bits <= (START_S + TOLERANCE) * BITS_PER_S * 1.01


def test_quality_stays_where_it_may() -> None:
    bucket = LeakyBucket(BITS_PER_S, FRAME_RATE)
    drive(bucket.choose(1), lambda _: ExpectedBits(160_000))
    found = [drive(bucket.choose(16), lambda _: ExpectedBits(161_000)) for _ in range(5)]
    assert len(set(found)) == 1


def test_a_new_scene_is_paid_for_later() -> None:
    """One group does not become much coarser; those after it take less until nothing is owed."""
    bucket, numbers, complexities = LeakyBucket(BITS_PER_S, FRAME_RATE), [], [1.0] * 40
    complexities[10] = 30.0
    owed = []
    for complexity in complexities:
        quality = drive(bucket.choose(8), lambda q, c=complexity: ExpectedBits(group_bits(q, 8, c)))
        numbers.append(number_of(quality))
        owed.append(bucket.level)
    assert numbers[10] - numbers[9] == MAX_RISE / STEPS
    assert owed[10] > 10 * abs(owed[9])
    assert abs(owed[-1]) <= 0.5 * TOLERANCE * WINDOW_S * BITS_PER_S


def test_five_qualities_are_tried_at_most() -> None:
    """Where bits fall in steps that no slope foretells, the nearest of those that were tried is taken."""
    search = QualitySearch(1000.0, 1.0, 0.02)
    best = drive(search.run(60, 200), lambda number: 4000.0 if number < 150 else 20.0)
    assert len(search.tried) == 5
    assert search.tried[best] == 20.0


KEY_BITS, NUM_FRAMES = 2000.0, 16


def live_group(bucket: LeakyBucket, complexity: float, ratio: float) -> list[int]:
    """Choose the quality of a group; return what a decoder asks for, of whose needs estimates are off."""
    estimates: dict[QualityStep, ExpectedBits] = {}

    def expect(quality: QualityStep) -> ExpectedBits:
        frames = np.full(NUM_FRAMES - 1, group_bits(quality, 16, complexity) / 15.0)
        estimates[quality] = ExpectedBits(KEY_BITS, frames)
        return estimates[quality]

    needs = ratio * estimates[drive(bucket.choose(NUM_FRAMES), expect)].asked
    share = min(bucket.allowed.sum() / needs.sum(), 1.0)
    return np.floor(share * needs).astype(np.int64).tolist()


@pytest.mark.parametrize("ratio", [0.6, 1.0, 1.4])
def test_what_decoders_ask_for_is_learnt(ratio: float) -> None:
    bucket, bits = LeakyBucket(BITS_PER_S, FRAME_RATE), []
    for number in range(60):
        asked = live_group(bucket, 1.0, ratio)
        bucket.account(number, np.array(asked))
        bits.append(KEY_BITS + sum(asked))
    assert all(abs(off) <= TOLERANCE for off in deviations([NUM_FRAMES] * 60, bits)[16:])
    assert bucket._asked / bucket._forecast == pytest.approx(ratio, rel=0.15)
    bucket.account(10**6, np.array([5]))  # a group of which nothing was estimated
    assert bucket.level <= 0.5 * TOLERANCE * WINDOW_S * BITS_PER_S


@pytest.mark.parametrize("wrong_by", [-0.5, -0.2, 0.3, 0.8])
def test_other_frames_make_up_for_a_key_frame_that_was_misjudged(wrong_by: float) -> None:
    """A predicted key frame is coded at the outlook; the rest of its group has another quality then."""
    bucket, bits = LeakyBucket(BITS_PER_S, FRAME_RATE), []

    def whole(quality: QualityStep) -> ExpectedBits:
        return ExpectedBits(group_bits(quality, NUM_FRAMES, 1.0))

    for _ in range(60):
        outlook = drive(bucket.outlook(NUM_FRAMES), whole)
        key = (1.0 + wrong_by) * 0.4 * group_bits(outlook, NUM_FRAMES, 1.0)

        def rest(quality: QualityStep, key: float = key) -> ExpectedBits:
            return ExpectedBits(key + 0.6 * group_bits(quality, NUM_FRAMES, 1.0))

        bits.append(rest(drive(bucket.choose(NUM_FRAMES, outlook), rest)).certain)
    assert max(map(abs, deviations([NUM_FRAMES] * 60, bits))) <= TOLERANCE


@settings(max_examples=50)
@given(st.randoms(use_true_random=False))
def test_no_window_takes_more_than_is_allowed(random: st.DataObject) -> None:
    """Whatever decoders need, while two groups are open; and what they do not take is little."""
    bucket, bits, waiting = LeakyBucket(BITS_PER_S, FRAME_RATE), [], deque[list[int]]()
    for number in range(50):
        ratio = 2.0 ** random.uniform(-0.5, 0.5)  # type: ignore[attr-defined]
        waiting.append(live_group(bucket, 1.0, ratio))
        bits.append(KEY_BITS + sum(waiting[-1]))
        if len(waiting) == 2:
            bucket.account(number - 1, np.array(waiting.popleft()))
    found = deviations([NUM_FRAMES] * 50, bits)
    assert max(found) <= TOLERANCE
    assert sum(found) / len(found) > -2.0 * TOLERANCE
    assert DEMAND_MARGIN > 1.0


def test_steps_of_quality_begin_with_frames_that_predict_none() -> None:
    distances = [2, 4, 2, 16, 2, 4, 2, 8]
    assert QualityStep.of(30 * STEPS).qps(distances) == [30] * 8
    half = QualityStep.of(30 * STEPS + STEPS // 2).qps(distances)
    assert half == [31, 30, 31, 30, 31, 30, 31, 30]
    assert QualityStep(51, 0.5).qps(distances) == [51] * 8


def test_what_decoders_ask_for_is_foreseen() -> None:
    found = forecast(QualityStep(30), [2, 4, 3, 8, 16], 1000)
    near, middle, far = (1000 * bits for bits in ASKED_BPP)
    assert found.tolist() == [near, middle, middle, far, far]
    coarser = forecast(QualityStep(33, 0.5), [2, 4], 1000)
    assert np.log2(found[:2] / coarser).tolist() == pytest.approx(
        [4 * ASKED_OCTAVES_PER_QP, 3 * ASKED_OCTAVES_PER_QP]
    )
    assert forecast(QualityStep(30), [], 1000).size == 0


@pytest.mark.parametrize(("max_bits", "qps"), [(7900.0, [31]), (2000.0, [43] * 3), (1.0, [51] * 3)])
def test_frames_that_do_not_fit_become_coarser(max_bits: float, qps: list[int]) -> None:
    qp, found = 30, []
    for _ in qps:
        if (num_bits := 8000 * 2.0 ** ((30 - qp) / 6)) > max_bits:
            qp = coarser_qp(qp, num_bits, max_bits)
        found.append(qp)
    assert found == qps


@pytest.mark.parametrize("name", ["bits_per_s", "bits_per_frame"])
def test_limits_are_numbers_of_bits(name: str) -> None:
    RateLimits(**{name: 10**12})
    for bits in (-5, 0, 10**12 + 1):
        with pytest.raises(ConfigError, match=f"{name}.* must be from 1 to"):
            RateLimits(**{name: bits})
