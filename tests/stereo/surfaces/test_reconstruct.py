"""Surfaces of all cameras of an array: scenes with known truth, poor input, and real sets."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.thesis import chapter2 as figure
from benchmarks.thesis.scenes import PAIRS
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition, Reconstruction
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import COST_NAMES, INFERENCE_NAMES, OCCLUSION_NAMES, StereoSettings
from tests.stereo.data import REAL_SETS, pair_of, pair_of_planes, real_set
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
    return pair_of(waves(shape, x), waves(shape, (x + 3.0) / (1.0 - 1.0 / 25.0))), truth


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
    array, labels = pair_of(left, right), DisparityLabels(0.0, 0.25, 33)
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
    one, two = (
        reconstruct(array, figure.LABELS, jobs=jobs, advance=steps.append if jobs == 1 else lambda _: None)
        for jobs in (1, 2)
    )
    for a, b in zip(one.surfaces, two.surfaces, strict=True):
        np.testing.assert_array_equal(a.disparity, b.disparity)
        np.testing.assert_array_equal(a.occluded, b.occluded)
        np.testing.assert_array_equal(a.confidence, b.confidence)
    assert one.figures == two.figures
    assert sum(steps) == len(array) * one.figures["iterations"]


def test_strips_are_seamless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A view that is cut into strips of rows has the same surface."""
    left, right, truth = pair_of_planes(200, 90)
    array = pair_of(left, right)
    whole = reconstruct(array, LABELS)
    monkeypatch.setattr("dvc.stereo.surfaces.reconstruct.MAX_CELLS", 140 * 90 * LABELS.num_labels)
    cut = reconstruct(array, LABELS)
    for a, b in zip(whole.surfaces, cut.surfaces, strict=True):
        assert (np.abs(a.disparity - b.disparity) > 0.5).mean() < 0.002
        assert (a.occluded != b.occluded).mean() < 0.002
    assert bad_pixels(cut, 0, truth) < 0.01


def test_large_views_start_from_half_the_size(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, truth = pair_of_planes(121, 181, near=14, far=4)
    array, labels = pair_of(left, right), DisparityLabels(-2.0, 1.0, 24)
    smooth = tuple(replace(view, image=blurred(view.image)) for view in array)
    monkeypatch.setattr("dvc.stereo.surfaces.reconstruct.LARGE_CELLS", 121 * 181 * 24 // 2)
    found = reconstruct(CameraArray(smooth), labels)
    assert bad_pixels(found, 0, truth) < 0.05
    assert found.surfaces[0].disparity.shape == (121, 181)
    assert found.surfaces[0].disparity.min() >= labels.lowest
    assert found.surfaces[0].disparity.max() <= labels.highest


def blurred(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return means of 3x3 pixels: halving needs a texture that survives it."""
    padded = np.pad(image.astype(np.float64), ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = image.shape[:2]
    parts = [padded[dy : dy + height, dx : dx + width] for dy in range(3) for dx in range(3)]
    return np.rint(np.mean(parts, axis=0)).astype(np.uint8)


@pytest.mark.parametrize("cost", COST_NAMES)
@pytest.mark.parametrize("inference", INFERENCE_NAMES)
def test_identical_views_are_far_away(cost: str, inference: str) -> None:
    """Views that do not differ have no disparity."""
    left, _, _ = pair_of_planes()
    settings = StereoSettings(cost=cost, inference=inference)
    found = reconstruct(pair_of(left, left), DisparityLabels(-3.0, 1.0, 7), settings)
    for surface in found.surfaces:
        assert not surface.disparity.any()
        assert not surface.occluded.any()


@pytest.mark.parametrize("cost", COST_NAMES)
@pytest.mark.parametrize("levels", [(0, 0), (128, 128), (255, 255), (40, 200)])
def test_constant_views_end(cost: str, levels: tuple[int, int]) -> None:
    array = pair_of(*(np.full((20, 30, 3), level, np.uint8) for level in levels))
    found = reconstruct(array, LABELS, StereoSettings(cost=cost, sub_pixel=True))
    for surface in found.surfaces:
        assert np.isfinite(surface.disparity).all()
        assert np.isfinite(surface.confidence).all()
        assert surface.disparity.min() >= -0.5
        assert surface.disparity.max() <= LABELS.highest + 0.5


@pytest.mark.parametrize("cost", COST_NAMES)
def test_range_of_one_label(cost: str) -> None:
    left, right, _ = pair_of_planes()
    found = reconstruct(pair_of(left, right), DisparityLabels(2.0, 1.0, 1), StereoSettings(cost=cost))
    for surface in found.surfaces:
        assert (surface.disparity == 2.0).all()
        assert np.isfinite(surface.confidence).all()


@pytest.mark.parametrize("dark", [0, 1])
def test_exposures_may_differ(dark: int) -> None:
    left, right, truth = pair_of_planes()
    views = list(pair_of(left, right))
    level = np.rint(0.8 * views[dark].image).astype(np.uint8)
    views[dark] = replace(views[dark], image=level)
    found = reconstruct(CameraArray(tuple(views)), LABELS)
    plain = reconstruct(pair_of(left, right), LABELS)
    assert bad_pixels(found, 0, truth) < bad_pixels(plain, 0, truth) + 0.01 < 0.03
    np.testing.assert_array_equal(found.array[dark].image, level), "views stay as they are"


def test_order_of_views_does_not_matter() -> None:
    """The right view first: the same surfaces, in the other order."""
    left, right, _ = pair_of_planes()
    array = pair_of(left, right)
    found, turned = reconstruct(array, LABELS), reconstruct(CameraArray(array.views[::-1]), LABELS)
    for a, b in zip(found.surfaces, turned.surfaces[::-1], strict=True):
        np.testing.assert_array_equal(a.disparity, b.disparity)


def test_columns_of_cameras_are_rows_turned() -> None:
    left, right, truth = pair_of_planes()
    upright = [image.transpose(1, 0, 2).copy() for image in (left, right)]
    places = LatticePosition(0.0, 0.0), LatticePosition(0.0, 1.0)
    views = zip(("upper", "lower"), upright, places, strict=True)
    found = reconstruct(CameraArray(tuple(ArrayView(*view) for view in views)), LABELS)
    assert bad_pixels(found, 0, truth.T) < 0.02


def test_disparities_between_labels() -> None:
    """On a slanted plane they are closer to the truth than labels are."""
    array, truth = slanted_pair()
    labels = DisparityLabels(0.0, 1.0, 10)
    inner = slice(8, -8), slice(12, -8)
    errors = [
        np.abs(reconstruct(array, labels, StereoSettings(sub_pixel=fine)).surfaces[0].disparity - truth)[
            inner
        ]
        for fine in (False, True)
    ]
    assert errors[0].mean() < 0.4
    assert errors[1].mean() < 0.6 * errors[0].mean()


def test_steps_of_fractions_of_a_pixel() -> None:
    """Labels may be a quarter of a pixel apart, and start below zero."""
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
    views = pair_of(left, damaged).views
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
