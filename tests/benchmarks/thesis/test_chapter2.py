"""Chapter 2: the scene of figure 2.4, settings as they are written, and results of steps."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.thesis.chapter2 import CHAPTER, FAR, LABELS, NEAR, SPRITES, THESIS, two_planes
from benchmarks.thesis.harness import Method, Task, planned
from dvc.geometry.camera_array import Reconstruction
from dvc.layers.layered_depth_image import layered_depth_image
from dvc.layers.sprites import SpriteSettings, extract_sprites
from dvc.stereo.evaluation import evaluate
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from tests.stereo.data import REAL_SETS, real_set

ARRAY, TRUTH = two_planes()


def _found(settings: StereoSettings = THESIS) -> Reconstruction:
    return reconstruct(ARRAY, LABELS, settings)


def test_two_planes_are_where_the_truth_says() -> None:
    """A point of one view is where its disparity puts it in another, unless the square hides it."""
    array, truth = two_planes()
    for source, view in enumerate(array):
        for target, other in enumerate(array):
            shift = other.position.m - view.position.m
            y, x = np.indices(array.shape)
            to_x = (x - shift * truth[source]).astype(np.int64)
            inside = (to_x >= 0) & (to_x < array.shape[1])
            there = y[inside], to_x[inside]
            seen = truth[target][there] == truth[source][inside]
            np.testing.assert_array_equal(view.image[inside][seen], other.image[there][seen])
            assert seen.mean() > 0.8
    assert LABELS.lowest < FAR < NEAR < LABELS.highest


def test_two_iterations_repair_what_one_leaves() -> None:
    """As for figure 2.4: errors are in the outer views after one iteration, hardly any after two."""
    for iterations, outer in ((1, (3.0, 6.0)), (2, (0.0, 0.3))):
        found = _found(replace(THESIS, max_iterations=iterations))
        bad = [
            evaluate(surface.disparity, known).bad_percent[1.0]
            for surface, known in zip(found.surfaces, TRUTH, strict=True)
        ]
        assert bad[1] < 0.3
        assert all(outer[0] <= bad[k] <= outer[1] for k in (0, 2))


@pytest.mark.parametrize(
    "change",
    [
        {"cost": "census"},
        {"filling": "continued"},
        {"max_iterations": 1},
        {"geometric_weight": 0.0},
        {"geometric_limit": 0.5},
        {"edge_strength": 0.05},
        {"undefined_cost": 0.5},
        {"occlusion": "none"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_every_setting_counts(change: dict[str, Any]) -> None:
    """Another value of any of them changes the surfaces."""
    written, changed = _found(), _found(replace(THESIS, **change))
    differs = [
        (one.disparity != other.disparity).any() or (one.confidence != other.confidence).any()
        for one, other in zip(written.surfaces, changed.surfaces, strict=True)
    ]
    assert any(differs)


def test_settings_are_those_that_are_written() -> None:
    """Values of the text, and our readings of open points."""
    assert (THESIS.cost, THESIS.max_iterations, THESIS.min_change) == ("squared", 5, 0.0)
    assert (THESIS.agreement, THESIS.filling, THESIS.edge_strength) == ("exact", "inferred", 1.0)
    assert not THESIS.exposures
    assert (THESIS.geometric_weight, THESIS.geometric_limit, THESIS.undefined_cost) == (0.1, 3.0, 0.2)
    assert SPRITES[Method.THESIS].space == "depth"


def test_sprites_compare_depth_or_disparity() -> None:
    """A step of disparity far away is a jump of depth, near by it is none."""
    image = layered_depth_image(_found(StereoSettings()))
    counts = {
        space: len(extract_sprites(image, SpriteSettings(space=space)).sprites)
        for space in ("disparity", "depth")
    }
    assert min(counts.values()) >= 2
    nearer = replace(
        image, disparity=np.where(image.occupied, image.disparity + 40.0, 0.0).astype(np.float32)
    )
    assert len(extract_sprites(nearer, SpriteSettings(space="depth")).sprites) >= 1


def test_steps_without_data_need_none(tmp_path: Path) -> None:
    """Only made-up scenes; with data all pairs, and more cameras in the full preset."""
    names = [step.name for step, _ in planned(CHAPTER, Task(tmp_path), (Method.DEFAULT,))]
    assert names == ["two-planes", "toy"]
    real_set("tsukuba")
    quick, full = (
        [step.name for step in CHAPTER.steps(Task(tmp_path, REAL_SETS, full=full))] for full in (False, True)
    )
    assert set(full) - set(quick) == {"cameras-25"}
    some = [step.name for step in CHAPTER.steps(Task(tmp_path, REAL_SETS, ("teddy",)))]
    assert some == ["two-planes", "toy", "pair-teddy"]


def test_a_step_makes_its_figure(tmp_path: Path) -> None:
    """Views, maps and errors of three cameras after one and two iterations."""
    (step,) = (step for step in CHAPTER.steps(Task(tmp_path)) if step.name == "two-planes")
    made = step.make(Task(tmp_path), Method.THESIS)
    (picture,) = made.pictures.values()
    assert list(made.pictures) == [("2.4", "")]
    assert picture.shape[1] == 3 * 2 * ARRAY.shape[1] + 2 * 8


def test_values_of_a_pair_have_printed_labels(tmp_path: Path) -> None:
    """Values have the names under which the thesis prints them."""
    real_set("tsukuba")
    task = Task(tmp_path, REAL_SETS, ("tsukuba",))
    make: Callable[..., Any] = next(step.make for step in CHAPTER.steps(task) if step.name == "pair-tsukuba")
    made = make(task, Method.THESIS)
    values = {(value.source, value.label): value.value for value in made.values}
    printed = {key for key in CHAPTER.printed if key in values}
    assert printed == {("Table 2.1", "tsukuba: bad pixels, all [%]")}
    assert 1.5 < values[printed.pop()] < 6.0
