"""Surfaces of all cameras: scenes with known truth, poor input, real and stored sets, and their settings."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.data import stereo_motorcycle

from benchmarks.thesis import chapter2 as figure
from benchmarks.thesis.scenes import PAIRS
from dvc.geometry.camera_array import CameraArray, DisparityLabels, Reconstruction
from dvc.geometry.label_inference import BeliefPropagation, SemiGlobal
from dvc.geometry.matching_costs import COSTS
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import (
    COST_NAMES,
    INFERENCE_NAMES,
    OCCLUSION_NAMES,
    StereoSettings,
    max_jump,
    tolerance,
)
from tests.stereo.data import REAL_SETS, array_of, pair_of_planes, real_set
from tests.stereo.plane_scenes import Plane, reconstruction_of

LABELS = DisparityLabels(0.0, 1.0, 9)


def bad_pixels(found: Reconstruction, index: int, truth: NDArray[np.floating], limit: float = 1.0) -> float:
    """Return the share of pixels that are farther off."""
    return float((np.abs(found.surfaces[index].disparity - truth) > limit).mean())


def waves(shape: tuple[int, int], x: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return levels that change smoothly, but not twice alike, at columns."""
    y = np.indices(shape)[0]
    levels = [
        128
        + 35 * np.sin(0.71 * x + 0.4 * y + k)
        + 30 * np.sin(0.37 * x - 0.23 * y)
        + 25 * np.cos(0.9 * y + k * x)
        for k in (0.0, 0.13, 0.29)
    ]
    return np.rint(np.clip(np.stack(levels, -1), 0, 255)).astype(np.uint8)


def slanted_pair(shape: tuple[int, int] = (48, 96)) -> tuple[CameraArray, NDArray[np.float64]]:
    """Return two views of a plane of disparity 3 + x / 25, and the disparity of the left view."""
    x = np.indices(shape, np.float64)[1]
    truth = 3.0 + x / 25.0
    # the right view has at u what the left one has at x with u = x - (3 + x / 25)
    return array_of(waves(shape, x), waves(shape, (x + 3.0) / (1.0 - 1.0 / 25.0))), truth


def test_two_planes_before_three_cameras() -> None:
    """Figure 2.4: nearly all disparities and occlusions are right at the second iteration."""
    array, truth = figure.two_planes()
    found = reconstruct(array, figure.LABELS, StereoSettings(max_iterations=2))
    for index, disparity in enumerate(truth):
        assert bad_pixels(found, index, disparity, 0.5) < 0.004
    rows, inner = slice(figure.TOP, figure.TOP + figure.SIDE), slice(figure.NEAR, -figure.NEAR)
    hidden = [np.zeros(array.shape, bool) for _ in truth]
    hidden[0][rows, figure.LEFT + figure.FAR : figure.LEFT + figure.NEAR] = True
    right = figure.LEFT + figure.SIDE
    hidden[2][rows, right - figure.NEAR : right - figure.FAR] = True
    for surface, expected in zip(found.surfaces, hidden, strict=True):
        assert (surface.occluded != expected)[:, inner].mean() < 0.004
    assert found.figures["iterations"] <= 2
    assert len(found.figures["changed"]) == found.figures["iterations"]


def test_labels_that_are_fewer_than_those_of_a_band_are_all_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, _ = pair_of_planes()
    array, labels = array_of(left, right), DisparityLabels(0.0, 0.25, 33)
    once = StereoSettings(max_iterations=1)
    whole = reconstruct(array, labels, once)
    monkeypatch.setattr("dvc.stereo.surfaces.reconstruct.LARGE_CELLS", 0)
    monkeypatch.setattr(
        "dvc.stereo.surfaces.reconstruct.MAX_STRIP_CELLS", left[..., 0].size * labels.num_labels
    )
    found = reconstruct(array, labels, once)
    for one, other in zip(found.surfaces, whole.surfaces, strict=True):
        np.testing.assert_array_equal(one.disparity, other.disparity)


@pytest.mark.parametrize("cost", COST_NAMES)
@pytest.mark.parametrize("inference", INFERENCE_NAMES)
@pytest.mark.parametrize("occlusion", OCCLUSION_NAMES)
def test_every_combination_finds_the_square(cost: str, inference: str, occlusion: str) -> None:
    array, truth = figure.two_planes()
    settings = StereoSettings(cost=cost, inference=inference, occlusion=occlusion)
    found = reconstruct(array, figure.LABELS, settings)
    worst = 0.06 if occlusion == "none" else 0.03
    for index, disparity in enumerate(truth):
        assert bad_pixels(found, index, disparity) < worst
        surface = found.surfaces[index]
        assert surface.disparity.dtype == np.float32
        assert surface.occluded.dtype == np.bool_
        assert surface.confidence.dtype == np.float32
        assert surface.confidence.min() >= 0.0
        assert surface.confidence.max() <= 1.0


def test_result_is_the_same_for_any_number_of_jobs() -> None:
    array, _ = figure.two_planes()
    steps: list[int] = []
    one = reconstruct(array, figure.LABELS, advance=steps.append)
    two = reconstruct(array, figure.LABELS, jobs=2)
    for a, b in zip(one.surfaces, two.surfaces, strict=True):
        np.testing.assert_array_equal(a.disparity, b.disparity)
        np.testing.assert_array_equal(a.occluded, b.occluded)
        np.testing.assert_array_equal(a.confidence, b.confidence)
    assert one.figures == two.figures
    assert sum(steps) == len(array) * one.figures["iterations"]


def test_strips_are_seamless(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, truth = pair_of_planes(200, 90)
    array = array_of(left, right)
    whole = reconstruct(array, LABELS)
    monkeypatch.setattr("dvc.stereo.surfaces.reconstruct.MAX_CELLS", 140 * 90 * LABELS.num_labels)
    cut = reconstruct(array, LABELS)
    for a, b in zip(whole.surfaces, cut.surfaces, strict=True):
        assert (np.abs(a.disparity - b.disparity) > 0.5).mean() < 0.002
        assert (a.occluded != b.occluded).mean() < 0.002
    assert bad_pixels(cut, 0, truth) < 0.01


def test_large_views_start_from_half_the_size(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, truth = pair_of_planes(121, 181, near=14, far=4)
    array, labels = array_of(left, right), DisparityLabels(-2.0, 1.0, 24)
    # halving needs a texture that survives it
    smooth = tuple(replace(view, image=cv2.blur(view.image, (3, 3))) for view in array)
    monkeypatch.setattr("dvc.stereo.surfaces.reconstruct.LARGE_CELLS", 121 * 181 * 24 // 2)
    found = reconstruct(CameraArray(smooth), labels)
    assert bad_pixels(found, 0, truth) < 0.05
    assert found.surfaces[0].disparity.shape == (121, 181)
    assert found.surfaces[0].disparity.min() >= labels.lowest
    assert found.surfaces[0].disparity.max() <= labels.highest


@pytest.mark.parametrize("cost", COST_NAMES)
@pytest.mark.parametrize("inference", INFERENCE_NAMES)
def test_identical_views_are_far_away(cost: str, inference: str) -> None:
    left, _, _ = pair_of_planes()
    settings = StereoSettings(cost=cost, inference=inference)
    found = reconstruct(array_of(left, left), DisparityLabels(-3.0, 1.0, 7), settings)
    for surface in found.surfaces:
        assert not surface.disparity.any()
        assert not surface.occluded.any()


@pytest.mark.parametrize("cost", COST_NAMES)
@pytest.mark.parametrize("levels", [(0, 0), (128, 128), (255, 255), (40, 200)])
def test_constant_views_end(cost: str, levels: tuple[int, int]) -> None:
    array = array_of(*(np.full((20, 30, 3), level, np.uint8) for level in levels))
    found = reconstruct(array, LABELS, StereoSettings(cost=cost, sub_pixel=True))
    for surface in found.surfaces:
        assert np.isfinite(surface.disparity).all()
        assert np.isfinite(surface.confidence).all()
        assert surface.disparity.min() >= -0.5
        assert surface.disparity.max() <= LABELS.highest + 0.5


@pytest.mark.parametrize("cost", COST_NAMES)
def test_range_of_one_label(cost: str) -> None:
    left, right, _ = pair_of_planes()
    found = reconstruct(array_of(left, right), DisparityLabels(2.0, 1.0, 1), StereoSettings(cost=cost))
    for surface in found.surfaces:
        assert (surface.disparity == 2.0).all()
        assert np.isfinite(surface.confidence).all()


def test_order_of_views_does_not_matter() -> None:
    left, right, _ = pair_of_planes()
    array = array_of(left, right)
    found, turned = reconstruct(array, LABELS), reconstruct(CameraArray(array.views[::-1]), LABELS)
    for a, b in zip(found.surfaces, turned.surfaces[::-1], strict=True):
        np.testing.assert_array_equal(a.disparity, b.disparity)


def test_columns_of_cameras_are_rows_turned() -> None:
    left, right, truth = pair_of_planes()
    upright = [image.transpose(1, 0, 2).copy() for image in (left, right)]
    found = reconstruct(array_of(*upright, places=[(0.0, 0.0), (0.0, 1.0)]), LABELS)
    assert bad_pixels(found, 0, truth.T) < 0.02


def test_disparities_between_labels() -> None:
    array, truth = slanted_pair()
    labels = DisparityLabels(0.0, 1.0, 10)
    inner = slice(8, -8), slice(12, -8)
    found = [reconstruct(array, labels, StereoSettings(sub_pixel=fine)) for fine in (False, True)]
    errors = [np.abs(one.surfaces[0].disparity - truth)[inner].mean() for one in found]
    assert errors[0] < 0.4
    assert errors[1] < 0.6 * errors[0]


def test_steps_of_fractions_of_a_pixel() -> None:
    array, truth = slanted_pair()
    found = reconstruct(array, DisparityLabels(-1.0, 0.25, 44))
    error = np.abs(found.surfaces[0].disparity - truth)[8:-8, 12:-8]
    assert error.mean() < 0.15
    assert (error > 1.0).mean() < 0.01


def test_cameras_off_the_lattice() -> None:
    labels = DisparityLabels(0.0, 0.5, 25)
    scene = reconstruction_of(
        [Plane(3.0), Plane(8.0, (24, 60), (14, 38))],
        [(0.0, 0.0), (0.93, 0.08), (-1.12, 0.05), (0.1, -0.87)],
        labels,
        (56, 84),
    )
    found = reconstruct(scene.array, labels)
    for index, surface in enumerate(scene.surfaces):
        inner = slice(8, -8), slice(12, -12)
        error = np.abs(found.surfaces[index].disparity - surface.disparity)[inner]
        assert (error > 1.0).mean() < 0.05


def test_what_was_not_seen_says_nothing() -> None:
    left, right, truth = pair_of_planes()
    rng = np.random.default_rng(1)
    valid = np.ones(truth.shape, bool)
    valid[:, -10:] = False
    valid[30:40, 8:20] = False
    damaged = right.copy()
    damaged[~valid] = rng.integers(0, 256, (np.count_nonzero(~valid), 3))
    views = array_of(left, damaged).views
    found = reconstruct(CameraArray((views[0], replace(views[1], valid=valid))), LABELS)
    assert bad_pixels(found, 0, truth) < 0.06
    assert np.isfinite(found.surfaces[1].disparity).all()


@pytest.mark.parametrize(
    ("name", "limit"), [("tsukuba", 3.0), pytest.param("cones", 8.5, marks=pytest.mark.slow)]
)
def test_real_pairs(name: str, limit: float) -> None:
    real_set(name)
    one = PAIRS[name]
    found = reconstruct(one.pair(REAL_SETS), one.labels, jobs=2)
    result = one.evaluate(REAL_SETS, found.surfaces[0].disparity)
    assert result["all"].bad_percent[1.0] < limit
    assert result["nonocc"].bad_percent[1.0] < result["all"].bad_percent[1.0]


def test_names_are_those_of_what_there_is() -> None:
    assert sorted(COST_NAMES) == sorted(COSTS)
    default = StereoSettings()
    assert default.cost in COST_NAMES
    assert default.inference in INFERENCE_NAMES
    assert default.occlusion in OCCLUSION_NAMES


@pytest.mark.parametrize("iteration", [0, 1, 2])
def test_raw_costs_have_no_windows(iteration: int) -> None:
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


FOLDER = Path(__file__).resolve().parents[2] / "golden" / "surfaces"
FROZEN_LABELS = DisparityLabels(0.0, 1.0, 16)
UNITS = 256.0
"""Of a disparity in pixels, and of a confidence, as they are kept."""
KEPT = {
    "labels": (StereoSettings(), (1.0, 1.0, 1.0)),
    "sub-pixel": (StereoSettings(sub_pixel=True), (0.92, 0.9, 0.88)),
}
"""Settings, and the exposures of the channels of the right view."""
MOST_OTHER, MOST_LESS_SURE = 0.002, 0.0005
"""Largest share of changed disparities, and largest mean change of the confidence."""


def motorcycle(exposures: tuple[float, float, float]) -> CameraArray:
    """Return the pair of scikit-image, a fifth as large."""
    left, right, _ = stereo_motorcycle()
    views = left, np.rint(right * np.array(exposures)).astype(np.uint8)
    small = [cv2.resize(view, (148, 100), interpolation=cv2.INTER_AREA) for view in views]
    return array_of(*small)


@pytest.mark.parametrize("name", KEPT)
def test_surfaces_are_those_that_are_kept(name: str) -> None:
    settings, exposures = KEPT[name]
    surfaces = reconstruct(motorcycle(exposures), FROZEN_LABELS, settings).surfaces
    rows = [np.hstack([one.disparity, one.confidence]) for one in surfaces]
    found: NDArray[np.uint16] = np.rint(UNITS * np.vstack(rows)).astype(np.uint16)
    path = FOLDER / f"{name}.png"
    if os.environ.get("DVC_REGENERATE") == "1":
        cv2.imwrite(str(path), found)
    kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert kept is not None
    off = np.abs(found / UNITS - kept / UNITS)
    disparity, confidence = np.hsplit(off, 2)
    assert (disparity > 1.0 / UNITS).mean() <= MOST_OTHER
    assert confidence.mean() <= MOST_LESS_SURE
