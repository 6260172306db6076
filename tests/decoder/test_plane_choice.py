"""What is asked for: bits in areas where they save more than they cost, and of bands that gain there."""

from collections.abc import Sequence

import numpy as np
import pytest

from decoder import frame_state as asking
from decoder.frame_state import CLASSES, MAX_WIDTH, STRENGTH_BITS, Asking, Band, Choice, Learned
from decoder.group import GroupAllowance
from decoder.wyner_ziv import Allowance
from dvc.slepian_wolf import PlaneCost
from dvc.wynerziv import quantizer
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.priors import LearnedPriors

SHAPE = (16, 24)
AREAS = Areas(SHAPE)
STEP, PLANES = 8.0, 5
MULTIPLIER = 0.1 * STEP**2
WRONG = (slice(4, 12), slice(8, 16))
"""Blocks of four areas in the middle, which are expected to be badly predicted."""


def band_of(number: int, scale: np.ndarray, planes: int = PLANES) -> Band:
    """Return a band of which the finest plane is missing, with predictions at random in their bins."""
    edges = quantizer.embedded_edges(number, planes, STEP)
    rng = np.random.default_rng(number)
    prefix = np.full(scale.size, (1 << planes - 1) // 2)
    lower, upper = quantizer.prefix_borders(prefix, 1, edges)
    band = Band(
        number, planes, PLANES * number, edges, rng.uniform(lower, upper), scale.ravel(), 1.0, 1.0, SHAPE,
        prefix, np.full(scale.size, planes - 1), np.arange(scale.size), lower, upper,
    )  # fmt: skip
    return band


def scales(inside: float, outside: float = 0.3) -> np.ndarray:
    """Return scales of the noise that are larger in some blocks."""
    found = np.full(SHAPE, outside)
    found[WRONG] = inside
    return found


def fresh() -> Learned:
    return Learned(LearnedPriors(SHAPE))


def chosen_areas(choice: Choice) -> np.ndarray:
    return AREAS.decoded(choice.areas).reshape(AREAS.shape)


def ask(bands: Sequence[Band], learned: Learned | None = None) -> list[Choice]:
    return Asking(AREAS, learned or fresh(), PlaneCost(1.06, 6.0), MULTIPLIER).by_areas(bands, 0)


def test_areas_that_are_badly_predicted_are_asked_for() -> None:
    (choice,) = ask([band_of(1, scales(40.0)), band_of(2, scales(40.0))])
    chosen = chosen_areas(choice)
    assert chosen[1:3, 2:4].all()
    assert not chosen[:, [0, 5]].any()
    assert choice.planes == (PLANES + PLANES - 1, 2 * PLANES + PLANES - 1)
    for wanted in choice.wanted:
        np.testing.assert_array_equal(np.flatnonzero(chosen.ravel()[AREAS.of_blocks]), wanted.blocks)
        assert wanted.expected[0] > MULTIPLIER * wanted.expected[1]
    assert choice.bits == 6.0 + sum(wanted.expected[1] for wanted in choice.wanted)


def test_a_good_prediction_is_left_alone() -> None:
    assert ask([band_of(1, scales(0.3)), band_of(2, scales(0.3))]) == []


def test_a_band_that_does_not_gain_is_left_out() -> None:
    (alone,) = ask([band_of(1, scales(40.0))])
    (choice,) = ask([band_of(1, scales(40.0)), band_of(2, scales(0.3))])
    assert (choice.planes, choice.areas) == (alone.planes, alone.areas)


def test_blocks_that_were_left_stay_so() -> None:
    first, second = band_of(1, scales(40.0)), band_of(2, scales(40.0))
    second.open = np.flatnonzero(np.arange(second.open.size) % SHAPE[1] < 12)
    (choice,) = ask([first, second])
    assert set(choice.wanted[1].blocks) == set(choice.wanted[0].blocks) & set(second.open)


@pytest.mark.parametrize(("saved", "is_asked"), [(0.2, False), (5.0, True)])
def test_what_was_learned_decides(saved: float, is_asked: bool) -> None:
    worth = fresh()
    worth.learn(1, 0, (1e9, 1e4), (saved * 1e9, 1e4))
    assert bool(ask([band_of(1, scales(7.0, 7.0))], worth)) == is_asked


def test_little_is_not_worth_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    bands = [band_of(1, scales(40.0))]
    (choice,) = ask(bands)
    (wanted,) = choice.wanted
    gain_bits = wanted.expected[0] / MULTIPLIER - wanted.expected[1]
    assert gain_bits > asking.LEAST_RUN_BITS
    monkeypatch.setattr(asking, "LEAST_RUN_BITS", 1.05 * gain_bits)
    assert ask(bands) == []


def test_long_runs_are_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    bands = [band_of(number, scales(40.0, 40.0)) for number in (9, 10, 11, 12, 13)]
    size = SHAPE[0] * SHAPE[1]
    for most, lengths in ((10 * size, [5]), (2 * size, [2, 2, 1]), (1, [1, 1, 1, 1, 1])):
        monkeypatch.setattr(asking, "MAX_RUN_BITS", most)
        assert [len(choice.planes) for choice in ask(bands)] == lengths


def test_whole_planes_are_asked_for_as_a_whole() -> None:
    chooser = Asking(AREAS, fresh(), PlaneCost(1.06, 6.0), MULTIPLIER)
    bands = [band_of(1, scales(40.0, 40.0)), band_of(2, scales(0.3)), band_of(3, scales(40.0, 40.0))]
    choices = chooser.whole_planes(bands, 0)
    assert [(choice.planes, choice.areas) for choice in choices] == [
        ((2 * PLANES - 1,), b""),
        ((4 * PLANES - 1,), b""),
    ]
    assert all(choice.wanted[0].blocks.size == SHAPE[0] * SHAPE[1] for choice in choices)


def test_without_a_slope_everything_is_asked_for() -> None:
    chooser = Asking(AREAS, fresh(), PlaneCost(1.06, 6.0), 0.0)
    (choice,) = chooser.by_areas([band_of(1, scales(0.3)), band_of(2, scales(40.0))], 0)
    assert (choice.planes, choice.areas) == ((2 * PLANES - 1, 3 * PLANES - 1), b"")
    assert len(chooser.whole_planes([band_of(1, scales(0.3))], 0)) == 1


LEARNED_MULTIPLIER = 40.0


def test_classes_hold_every_band_once() -> None:
    assert [band for bands in CLASSES for band in bands] == list(range(16))


def test_nothing_learned_leaves_expectations_as_they_are() -> None:
    worth = fresh()
    assert {worth.factors(band, width, LEARNED_MULTIPLIER) for band in range(16) for width in range(12)} == {
        (1.0, 1.0)
    }


def test_factors_go_from_one_to_what_was_seen() -> None:
    worth = fresh()
    strength = STRENGTH_BITS * LEARNED_MULTIPLIER
    worth.learn(0, 1, (strength, STRENGTH_BITS), (0.5 * strength, 2.0 * STRENGTH_BITS))
    assert worth.factors(0, 1, LEARNED_MULTIPLIER) == pytest.approx((0.75, 1.5))
    for _ in range(2000):
        worth.learn(0, 1, (strength, STRENGTH_BITS), (0.5 * strength, 2.0 * STRENGTH_BITS))
    assert worth.factors(0, 1, LEARNED_MULTIPLIER) == pytest.approx((0.5, 2.0), rel=1e-3)


@pytest.mark.parametrize(
    ("band", "width", "is_alike"),
    [(1, 2, True), (2, 2, True), (0, 2, False), (3, 2, False), (1, 1, False), (15, 2, False)],
)
def test_bands_of_a_class_learn_together(band: int, width: int, is_alike: bool) -> None:
    worth = fresh()
    worth.learn(1, 2, (100.0, 50.0), (900.0, 10.0))
    assert (worth.factors(band, width, LEARNED_MULTIPLIER) != (1.0, 1.0)) == is_alike


def test_wide_bins_count_as_alike() -> None:
    worth = fresh()
    worth.learn(0, MAX_WIDTH + 3, (100.0, 50.0), (900.0, 10.0))
    assert worth.factors(0, MAX_WIDTH, 1.0) == worth.factors(0, MAX_WIDTH + 1, 1.0) != (1.0, 1.0)


def test_frames_side_by_side_add_up() -> None:
    together = fresh()
    together.learn(0, 0, (10.0, 5.0), (20.0, 6.0))
    before = together.worth.copy()
    several = [together.copy() for _ in range(3)]
    for number, own in enumerate(several, 1):
        own.learn(0, number, (10.0 * number, 1.0), (1.0, 1.0))
    np.testing.assert_array_equal(together.worth, before)
    joined, expected = together.joined(several), together.copy()
    for number in (3, 1, 2):
        expected.learn(0, number, (10.0 * number, 1.0), (1.0, 1.0))
    np.testing.assert_array_equal(joined.worth, expected.worth)


def bits_of(group: GroupAllowance, *frames: int) -> list[float]:
    return [allowance.bits for allowance in group.begin_level(frames)]


def test_planes_begin_as_long_as_there_is_room_for_them() -> None:
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
    assert bits_of(GroupAllowance({1: 900, 2: 50}), 1) == [pytest.approx(950.0)]
    group = GroupAllowance({1: 100, 2: 100})
    group.begin_level([1])
    group.end_level(300)
    assert bits_of(group, 2) == [0.0]
    assert bits_of(GroupAllowance({1: 0, 2: 0}), 1) == [0.0]


def test_without_a_bitrate_nothing_is_limited() -> None:
    group = GroupAllowance(None)
    assert [allowance.bits for allowance in group.begin_level([3, 5])] == [float("inf")] * 2
    group.end_level(10**9)
    assert group.begin_level([4])[0].begin(10.0**9)
