"""Photometric costs against equations (2.17) to (2.20) on volumes, and exposures of views."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry.aggregation import Window, cross_arms
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.matching_costs import COSTS, SQUARED_LIMIT, Band
from dvc.stereo.surfaces.occupancy import (
    MIN_POINTS,
    UNDEFINED_SHARE,
    Comparison,
    Occupancy,
    Regions,
    gains,
    neighbours,
    photometric_cost,
    with_gains,
)
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import UNDEFINED_COST, StereoSettings
from tests.reference import stereo_volumes as volumes
from tests.stereo.data import pair_of, pair_of_planes
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of

SHAPE = (9, 12)
FEW = DisparityLabels(0.0, 1.0, 4)
SLACK = 1
"""Smallest difference of labels between a surface and a point that it hides."""
CROSS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))


def random_cross(rng: np.random.Generator) -> CameraArray:
    """Return five views of little contrast, so that few differences reach the limit."""
    return CameraArray(
        tuple(
            ArrayView(f"{m},{n}", rng.integers(90, 130, (*SHAPE, 3)).astype(np.uint8), LatticePosition(m, n))
            for m, n in CROSS
        )
    )


def single_pixels(array: CameraArray, labels: DisparityLabels) -> Regions:
    nothing = np.zeros(array.shape, np.int64)
    return Regions((), (), nothing, Band(nothing, labels.num_labels))


def filled(error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mix the constant into defined costs, and fill undefined ones with it."""
    known = (error + UNDEFINED_SHARE * UNDEFINED_COST) / (1.0 + UNDEFINED_SHARE)
    return np.where(np.isnan(error), UNDEFINED_COST, known)


def pictures_at(array: CameraArray, index: int) -> NDArray[np.float64]:
    """Return the picture of a camera as a volume (H, W, labels, 3) in the frame of the first; NaN outside."""
    m, n = CROSS[index]
    picture = np.repeat(array[index].image[:, :, None].astype(np.float64), FEW.num_labels, axis=2)
    return volumes.sheared(picture, -m, -n, np.nan)


def test_implicit_occlusion(rng: np.random.Generator) -> None:
    """Without surfaces the smaller error of opposite cameras counts (2.18), and the mean of directions."""
    array = random_cross(rng)
    near = neighbours(array, 0)
    assert near == ((1, 2), (3, 4))
    own = array[0].image.astype(np.float64)
    errors = [
        volumes.truncated_error(own, [pictures_at(array, k) for k in side], SQUARED_LIMIT) for side in near
    ]
    inside = [~np.isnan([pictures_at(array, k)[..., 0] for k in side]).all(axis=0) for side in near]
    expected = filled(volumes.photometric_cost(errors, inside) / SQUARED_LIMIT)
    comparison = Comparison(array, FEW, COSTS["squared"])
    everything = slice(0, SHAPE[0])
    got = photometric_cost(comparison, 0, near, single_pixels(array, FEW), None, everything)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    assert 0.1 < (got < UNDEFINED_COST).mean() < 1.0
    strip = photometric_cost(comparison, 0, near, single_pixels(array, FEW), None, slice(3, 6))
    np.testing.assert_array_equal(strip, got[3:6])


def test_explicit_visibility(rng: np.random.Generator) -> None:
    """Only cameras that see the same point count (2.19); the cost is a constant if none does."""
    array = random_cross(rng)
    near = neighbours(array, 0)
    occupancy = [Occupancy(rng.integers(0, 4, SHAPE), rng.random(SHAPE) < 0.6) for _ in CROSS]
    seen = [
        volumes.sheared(volumes.visibility(volumes.occupancy(*one, FEW.num_labels), SLACK), -m, -n, True)
        for one, (m, n) in zip(occupancy, CROSS, strict=True)
    ]
    own = array[0].image.astype(np.float64)
    errors, valid = [], []
    for side in near:
        views = [pictures_at(array, k) for k in side]
        for k, view in zip(side, views, strict=True):
            view[~volumes.validity(seen[0], [seen[k]])] = np.nan
        errors.append(volumes.truncated_error(own, views, SQUARED_LIMIT))
        inside = np.stack([~np.isnan(view[..., 0]) for view in views])
        valid.append(inside.any(axis=0))
        whole = [~np.isnan(pictures_at(array, k)[..., 0]) for k in side]
        both = np.logical_and.reduce(whole)
        textbook = volumes.validity(seen[0], [seen[k] for k in side])
        np.testing.assert_array_equal(valid[-1][both], textbook[both])
    expected = filled(volumes.photometric_cost(errors, valid) / SQUARED_LIMIT)
    comparison = Comparison(array, FEW, COSTS["squared"])
    everything = slice(0, SHAPE[0])
    got = photometric_cost(comparison, 0, near, single_pixels(array, FEW), occupancy, everything)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    without = photometric_cost(comparison, 0, near, single_pixels(array, FEW), None, everything)
    assert (got != without).any()


def test_mean_of_opposite_views_on_demand(rng: np.random.Generator) -> None:
    """Without any treatment of occlusions all neighbours count alike."""
    array = CameraArray(random_cross(rng).views[:3])
    near = neighbours(array, 0)
    comparison = Comparison(array, FEW, COSTS["squared"], smaller_of_opposite=False)
    regions, everything = single_pixels(array, FEW), slice(0, SHAPE[0])
    got = photometric_cost(comparison, 0, near, regions, None, everything)
    own = array[0].image.astype(np.float64)
    parts = [volumes.truncated_error(own, [pictures_at(array, k)], SQUARED_LIMIT) for k in (1, 2)]
    inside = [~np.isnan(pictures_at(array, k)[..., 0]) for k in (1, 2)]
    expected = filled(volumes.photometric_cost(parts, inside) / SQUARED_LIMIT)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    smaller = photometric_cost(Comparison(array, FEW, COSTS["squared"]), 0, near, regions, None, everything)
    assert (smaller <= got + 1e-6).all()


@pytest.mark.parametrize("cost", sorted(COSTS))
def test_true_surfaces_cost_least(cost: str) -> None:
    scene = reconstruction_of(SCENE, [(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)], LABELS)
    truth = [LABELS.label(surface.disparity) for surface in scene.surfaces]
    occupancy = [Occupancy(label, np.ones(label.shape, bool)) for label in truth]
    near = neighbours(scene.array, 1)
    regions, everything = single_pixels(scene.array, LABELS), slice(0, scene.array.shape[0])
    comparison = Comparison(scene.array, LABELS, COSTS[cost])
    costs = photometric_cost(comparison, 1, near, regions, occupancy, everything)
    least = costs.min(axis=2)
    true = np.take_along_axis(costs, truth[1][:, :, None], axis=2)[:, :, 0]
    assert (true <= least + 1e-6).mean() > (0.97 if cost == "squared" else 0.75)


def test_regions_of_every_window_count_alike(rng: np.random.Generator) -> None:
    shape = (20, 30)
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    array = CameraArray(
        tuple(ArrayView(str(m), np.roll(image, -m, axis=1), LatticePosition(m, 0.0)) for m in (0, 1))
    )
    nothing = np.zeros(shape, np.int64)
    windows = Window(3, 2, 1), Window(6, 4, 2)
    arms = [cross_arms(image // 16, window) for window in windows]
    near, everything = neighbours(array, 0), slice(0, shape[0])
    comparison = Comparison(array, FEW, COSTS["census"])

    def _cost(*chosen: int) -> NDArray[np.float32]:
        some = [arms[k] for k in chosen], [windows[k] for k in chosen]
        regions = Regions(*some, nothing, Band(nothing, FEW.num_labels))
        return photometric_cost(comparison, 0, near, regions, None, everything)

    both, first, second = (_cost(*chosen)[:, 15:] for chosen in ((0, 1), (0,), (1,)))
    np.testing.assert_allclose(both, 0.5 * (first + second), atol=1e-5)
    assert (first != second).any()


def test_band_follows_the_surface(rng: np.random.Generator) -> None:
    """Costs of a few labels around a base surface are those of the whole volume, cut at its jumps."""
    shape, labels = (16, 30), DisparityLabels(0.0, 1.0, 12)
    image = rng.integers(60, 200, (*shape, 3)).astype(np.uint8)
    views = tuple(ArrayView(str(m), np.roll(image, -2 * m, axis=1), LatticePosition(m, 0.0)) for m in (0, 1))
    array = CameraArray(views)
    base = np.where(np.indices(shape)[1] < 14, 3, 8) + np.indices(shape)[0] // 8
    occupancy = [Occupancy(base, rng.random(shape) < 0.5) for _ in views]
    arms, window = cross_arms(np.zeros((*shape, 3), np.uint8), Window(7, 7, 1)), Window(7, 7, 1)
    comparison, near = Comparison(array, labels, COSTS["census"]), neighbours(array, 0)
    bands = Band(np.zeros(shape, np.int64), labels.num_labels), Band(base - 2, 5)
    whole, part = (
        photometric_cost(
            comparison, 0, near, Regions([arms], [window], base, band), occupancy, slice(0, shape[0])
        )
        for band in bands
    )
    np.testing.assert_allclose(part, volumes.banded(whole, base - 2, 5, np.nan), atol=2e-4)


TWELVE_LABELS = DisparityLabels(0.0, 1.0, 12)
FACTORS = np.array([0.8, 0.9, 1.1])


def shifted_pair(by: int) -> CameraArray:
    """Return a picture and the same moved to the left, with other levels in each channel."""
    levels = np.random.default_rng(213).integers(40, 200, (30, 60, 3)).astype(np.uint8)
    other = np.rint(np.roll(levels, -by, axis=1) * FACTORS).astype(np.uint8)
    return pair_of(levels, other)


def test_gains_are_those_of_what_both_see() -> None:
    """Channel by channel, along the surface; the reference keeps its levels."""
    array = shifted_pair(3)
    surface = Occupancy(np.full(array.shape, 3), np.ones(array.shape, np.bool_))
    found = gains(array, TWELVE_LABELS, surface)
    np.testing.assert_array_equal(found[0], 1.0)
    np.testing.assert_allclose(found[1], 1.0 / FACTORS, rtol=0.01)
    same = with_gains(array, found)
    assert same[0] is array[0]
    difference = same[1].image[:, :57].astype(int) - array[0].image[:, 3:]
    assert np.abs(difference).mean() < 1.0


def test_few_points_change_no_levels() -> None:
    array = shifted_pair(3)
    supported = np.zeros(array.shape, np.bool_)
    supported.ravel()[: MIN_POINTS - 1] = True
    found = gains(array, TWELVE_LABELS, Occupancy(np.full(array.shape, 3), supported))
    np.testing.assert_array_equal(found, 1.0)


def test_surfaces_are_those_of_equal_exposures() -> None:
    left, right, truth = pair_of_planes()
    darker = pair_of(left, np.rint(right * np.array([0.85, 0.8, 0.75])).astype(np.uint8))
    as_it_is = StereoSettings(exposures=False)
    found = [
        reconstruct(pair_of(left, right), TWELVE_LABELS),
        reconstruct(darker, TWELVE_LABELS),
        reconstruct(darker, TWELVE_LABELS, as_it_is),
    ]
    bad = [float((np.abs(one.surfaces[0].disparity - truth) > 1.0).mean()) for one in found]
    assert bad[1] < bad[0] + 0.001 < bad[2]
