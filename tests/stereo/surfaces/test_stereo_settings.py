"""Settings of a reconstruction: their windows and methods."""

import pytest

from dvc.geometry.label_inference import BeliefPropagation, SemiGlobal
from dvc.geometry.matching_costs import COSTS
from dvc.stereo.surfaces.stereo_settings import (
    COST_NAMES,
    INFERENCE_NAMES,
    OCCLUSION_NAMES,
    StereoSettings,
    max_jump,
    tolerance,
)


def test_names_are_those_of_what_there_is() -> None:
    assert sorted(COST_NAMES) == sorted(COSTS)
    default = StereoSettings()
    assert default.cost in COST_NAMES
    assert default.inference in INFERENCE_NAMES
    assert default.occlusion in OCCLUSION_NAMES


@pytest.mark.parametrize("iteration", [0, 1, 2])
def test_raw_costs_have_no_windows(iteration: int) -> None:
    """Squared differences stay those of pixels by themselves; other costs are summed."""
    assert StereoSettings(cost="squared").windows(iteration) == ()
    assert StereoSettings(cost="census").windows(iteration)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (StereoSettings(), [True, False, False]),
        (StereoSettings(cost="squared"), [True, True, True]),
        (StereoSettings(occlusion="implicit"), [True, True, True]),
        (StereoSettings(occlusion="none"), [False, False, False]),
    ],
)
def test_smaller_costs_count_until_visibility_is_known(
    settings: StereoSettings, expected: list[bool]
) -> None:
    """Costs of regions need (2.18) only without surfaces, costs of single pixels always."""
    assert [settings.takes_smaller(iteration) for iteration in range(3)] == expected


def test_scanlines_find_the_first_base_surface() -> None:
    kinds = [type(StereoSettings().inference_method(k, 1.0)) for k in range(3)]
    assert kinds == [SemiGlobal, BeliefPropagation, BeliefPropagation]
    assert type(StereoSettings(cost="squared").inference_method(0, 1.0)) is BeliefPropagation
    assert type(StereoSettings(inference="semi-global").inference_method(2, 1.0)) is SemiGlobal


def test_finer_labels_cost_and_jump_as_their_pixels() -> None:
    coarse, fine = (StereoSettings(cost="squared").inference_method(1, fineness) for fineness in (1.0, 4.0))
    assert isinstance(coarse, BeliefPropagation)
    assert isinstance(fine, BeliefPropagation)
    assert fine.slope == pytest.approx(coarse.slope / 4.0)
    assert fine.limit == coarse.limit
    assert fine.max_jump == max_jump(4.0) == 4 * max_jump(1.0)
    assert tolerance(1.0) == 1
    assert tolerance(8.0) > tolerance(4.0) > tolerance(1.0)
