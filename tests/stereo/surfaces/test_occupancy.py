"""Occupancy, visibility (2.15 to 2.17) and costs (2.17 to 2.20) against volumes of voxels, and exposures."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.matching_costs import COSTS, SQUARED_LIMIT, Band, Window, cross_arms
from dvc.stereo.surfaces import occupancy
from dvc.stereo.surfaces.occupancy import (
    MIN_POINTS,
    UNDEFINED_SHARE,
    Comparison,
    Occupancy,
    agreement,
    gains,
    neighbours,
    photometric_cost,
    seen_elsewhere,
    shifts,
    supported,
    with_gains,
)
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import UNDEFINED_COST, StereoSettings
from tests.reference import stereo_volumes as volumes
from tests.stereo.data import array_of, pair_of_planes
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice
from tests.twins import Choose

FEW = DisparityLabels(0.0, 1.0, 5)
SHAPE = (10, 13)
CENTRE = LatticePosition(0.0, 0.0)


def array_at(*positions: tuple[float, float], shape: tuple[int, int] = SHAPE) -> CameraArray:
    """Return black views."""
    return array_of(*np.zeros((len(positions), *shape, 3), np.uint8), places=positions)


def random_occupancy(rng: np.random.Generator, share: float = 0.7) -> Occupancy:
    return Occupancy(rng.integers(0, FEW.num_labels, SHAPE), rng.random(SHAPE) < share)


def seen_by(other: Occupancy, m: int, n: int, reach: int = 0) -> volumes.Volume:
    """Return the voxels of camera (m, n), within a reach of labels, in the frame of camera (0, 0)."""
    volume = volumes.occupancy(*other, FEW.num_labels)
    return volumes.sheared(volumes.thickened(volume, reach), -m, -n, False)


@pytest.mark.nojit
@pytest.mark.parametrize(("m", "n"), [(1, 0), (-1, 0), (0, 1), (0, -2)])
@pytest.mark.parametrize("tolerance", [0, 1])
def test_agreement(choose: Choose, rng: np.random.Generator, m: int, n: int, tolerance: int) -> None:
    """A voxel agrees that the other camera has, too, in the same frame and within the tolerance (2.15)."""
    own, other = Occupancy(random_occupancy(rng).label, np.ones(SHAPE, bool)), random_occupancy(rng)
    found, looking = np.empty(SHAPE, bool), np.empty(SHAPE, bool)
    moved = shifts(FEW, CENTRE, LatticePosition(m, n))
    choose(occupancy._agree)(own.label, *other, moved, tolerance, found, looking)
    mine = volumes.occupancy(*own, FEW.num_labels)
    np.testing.assert_array_equal(found, (mine & seen_by(other, m, n, tolerance)).any(axis=2))
    seen = np.repeat(other.supported[:, :, None], FEW.num_labels, axis=2)
    np.testing.assert_array_equal(looking, (mine & volumes.sheared(seen, -m, -n, False)).any(axis=2))
    assert 0 < found.sum() < looking.sum() < found.size


@pytest.mark.nojit
@pytest.mark.parametrize(("m", "n", "slack"), [(1, 0, 1), (-2, 0, 0), (0, 1, 1), (-1, 0, 2)])
def test_hidden_voxels_lose_their_weight(
    choose: Choose, rng: np.random.Generator, m: int, n: int, slack: int
) -> None:
    """Voxels that a camera sees but its neighbour does not are invalid: (2.19) with (2.17)."""
    own, other = random_occupancy(rng), random_occupancy(rng, 0.4)
    origin = rng.integers(-2, 3, SHAPE)
    weight = np.ones((6, SHAPE[1], FEW.num_labels), np.float32)
    moved = shifts(FEW, CENTRE, LatticePosition(m, n))
    choose(occupancy._clear_invisible)(*own, *other, moved, origin, slack, 2, weight)
    mine, theirs = (
        volumes.visibility(volumes.occupancy(*one, FEW.num_labels), slack) for one in (own, other)
    )
    valid = volumes.validity(mine, [volumes.sheared(theirs, -m, -n, True)])
    np.testing.assert_array_equal(weight, volumes.banded(valid, origin, FEW.num_labels, True)[2:8])
    assert 0 < np.count_nonzero(weight == 0) < 0.7 * weight.size


@pytest.mark.nojit
@pytest.mark.parametrize("limit", [1.0, 3.0])
def test_distance_from_the_surface_is_added(choose: Choose, rng: np.random.Generator, limit: float) -> None:
    """Costs rise by the weighted geometric cost (2.16), and stay the same in empty columns."""
    own, origin = random_occupancy(rng), rng.integers(0, 3, SHAPE)
    cost = rng.random((*SHAPE, 3)).astype(np.float32)
    distance = volumes.geometric_cost(volumes.occupancy(*own, FEW.num_labels), limit)
    expected = cost + 0.25 * volumes.banded(distance, origin, 3, np.nan)
    choose(occupancy.add_distance)(*own, origin, np.float32(0.25), limit, cost)
    np.testing.assert_allclose(cost, expected, rtol=1e-6)


def test_support_is_that_of_volumes(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cross of five: one of the horizontal and one of the vertical neighbours must have a voxel (2.15)."""
    monkeypatch.setattr(occupancy, "MIN_REGION_PX", 0)
    places = [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)]
    maps = [rng.integers(1, 4, SHAPE) for _ in places]
    all_seen, everywhere = np.ones(SHAPE, bool), np.ones((*SHAPE, FEW.num_labels), bool)
    others = [
        (seen_by(Occupancy(label, all_seen), *at, 1), volumes.sheared(everywhere, -at[0], -at[1], False))
        for label, at in zip(maps, places, strict=True)
    ]
    mine = volumes.occupancy(maps[0], all_seen, FEW.num_labels)
    expected = volumes.with_support_in_frames(mine, others[1:3], others[3:]).any(axis=2)
    got = supported(array_at(*places), FEW, maps, 0)
    np.testing.assert_array_equal(got, expected)
    assert 0 < got.sum() < got.size
    pair = supported(array_at(*places[:2]), FEW, maps[:2], 0)
    np.testing.assert_array_equal(pair, volumes.with_support(mine, [others[1][0]], []).any(axis=2))


def test_exact_support_is_the_printed_one(rng: np.random.Generator) -> None:
    """Labels must be equal, voxels outside a view are empty, and empty brackets are left out (2.15)."""
    places = [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)]
    maps = [rng.integers(1, 4, SHAPE) for _ in places]
    all_seen = np.ones(SHAPE, bool)
    others = [seen_by(Occupancy(label, all_seen), *at) for label, at in zip(maps, places, strict=True)]
    mine = volumes.occupancy(maps[0], all_seen, FEW.num_labels)
    cross = (mine & (others[1] | others[2]) & (others[3] | others[4])).any(axis=2)
    np.testing.assert_array_equal(supported(array_at(*places), FEW, maps, 0, exact=True), cross)
    row = (mine & (others[1] | others[2])).any(axis=2)
    np.testing.assert_array_equal(supported(array_at(*places[:3]), FEW, maps[:3], 0, exact=True), row)
    assert 0 < cross.sum() < row.sum() < row.size


def test_nothing_agrees_with_what_is_empty() -> None:
    places, shape = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], (30, 40)
    array, flat = array_at(*places, shape=shape), [np.full(shape, 2)] * 3
    valid = np.indices(shape)[1] < 25
    emptied = CameraArray((array[0], replace(array[1], valid=valid), replace(array[2], valid=valid)))
    y, x = np.indices(shape)
    besides, below = (x >= 2) & (x - 2 < 25), (y >= 2) & (x < 25)
    np.testing.assert_array_equal(seen_elsewhere(emptied, LABELS, flat, 0), besides | below)
    np.testing.assert_array_equal(supported(emptied, LABELS, flat, 0), besides | below)
    mine = CameraArray((replace(array[0], valid=valid), array[1], array[2]))
    np.testing.assert_array_equal(supported(mine, LABELS, flat, 0), valid & ((x >= 2) | (y >= 2)))


def test_speckles_have_no_support() -> None:
    array = array_at((0, 0), (1, 0), shape=(40, 60))
    far = np.full((40, 60), 2)
    small, large = far.copy(), far.copy()
    side = int(occupancy.MIN_REGION_PX**0.5)
    small[10 : 10 + side - 1, 20 : 20 + side - 1] = 9
    large[10 : 10 + 2 * side, 20 : 20 + 2 * side] = 9
    for label, is_kept in ((small, False), (large, True)):
        other = np.roll(np.where(label == 9, 9, 2), -9, axis=1)
        kept = supported(array, LABELS, [label, other], 0)
        assert (kept[label == 9] == is_kept).all()
        assert kept[30:, 5:].all(), "the surface around it"


def test_points_are_seen_elsewhere_if_any_camera_agrees() -> None:
    scene = reconstruction_of(SCENE, square_lattice(1), LABELS)
    maps = [LABELS.label(surface.disparity) for surface in scene.surfaces]
    assert seen_elsewhere(scene.array, LABELS, maps, 0).all(), "eight cameras around"
    pair = CameraArray(scene.array.views[:2])
    seen = seen_elsewhere(pair, LABELS, maps, 0)
    assert 0 < np.count_nonzero(~seen) < seen.size, "some must be occluded"
    np.testing.assert_array_equal(seen, agreement(pair, LABELS, maps, (0, 1)).agreeing)


@pytest.mark.parametrize(
    ("places", "horizontal", "vertical"),
    [
        ([(0, 0), (1, 0)], (1,), ()),
        ([(0, 0), (0, 3)], (), (1,)),
        ([(0, 0), (-1, 0), (1, 0), (2, 0), (0, -1), (0, 1)], (1, 2), (4, 5)),
        ([(0, 0), (2, 0), (1, 0), (0, 2), (0, 1)], (2,), (4,)),
        ([(0.0, 0.0), (1.1, 0.2), (0.1, -0.9), (-0.8, -0.1), (0.9, 0.8)], (3, 1), (2,)),
    ],
)
def test_nearest_cameras_on_each_side_are_neighbours(
    places: list[tuple[float, float]], horizontal: tuple[int, ...], vertical: tuple[int, ...]
) -> None:
    near = neighbours(array_at(*places), 0)
    assert near == (horizontal, vertical)
    assert near.all == horizontal + vertical


def test_shifts_are_rounded_to_whole_pixels() -> None:
    """Real positions and steps move points by the nearest whole number, halves upwards (2.5)."""
    labels = DisparityLabels(-1.0, 0.5, 4)
    moved = shifts(labels, LatticePosition(0.0, 1.0), LatticePosition(0.7, 0.0))
    assert moved[:, 0].tolist() == [1, 0, 0, 0]  # 0.7, 0.35, 0, -0.35
    assert moved[:, 1].tolist() == [-1, 0, 0, 1]  # -1, -0.5, 0, 0.5


SMALL = (9, 12)
FOUR = DisparityLabels(0.0, 1.0, 4)
SLACK = 1
"""Smallest difference of labels between a surface and a point that it hides."""
CROSS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))


def random_cross(rng: np.random.Generator, count: int = 5) -> CameraArray:
    """Return views of little contrast, so that few differences reach the limit."""
    return array_of(*rng.integers(90, 130, (count, *SMALL, 3)).astype(np.uint8), places=CROSS[:count])


def squared_cost(
    array: CameraArray,
    occupancy: list[Occupancy] | None = None,
    rows: slice = slice(0, SMALL[0]),
    *,
    smaller: bool = True,
) -> NDArray[np.float32]:
    """Return the cost of single pixels of the first camera."""
    nothing = np.zeros(array.shape, np.int64)
    band = Band(nothing, FOUR.num_labels)
    comparison = Comparison(array, FOUR, COSTS["squared"], smaller_of_opposite=smaller)
    return photometric_cost(comparison, 0, neighbours(array, 0), (), (), nothing, band, occupancy, rows)


def filled(error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mix the constant into defined costs, and fill undefined ones with it."""
    known = (error + UNDEFINED_SHARE * UNDEFINED_COST) / (1.0 + UNDEFINED_SHARE)
    return np.where(np.isnan(error), UNDEFINED_COST, known)


def pictures_at(array: CameraArray, index: int) -> NDArray[np.float64]:
    """Return the picture of a camera as a volume (H, W, labels, 3) in the frame of the first; NaN outside."""
    m, n = CROSS[index]
    picture = np.repeat(array[index].image[:, :, None].astype(np.float64), FOUR.num_labels, axis=2)
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
    got = squared_cost(array)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    assert 0.1 < (got < UNDEFINED_COST).mean() < 1.0
    np.testing.assert_array_equal(squared_cost(array, rows=slice(3, 6)), got[3:6])


def test_explicit_visibility(rng: np.random.Generator) -> None:
    """Only cameras that see the same point count (2.19); the cost is a constant if none does."""
    array = random_cross(rng)
    near = neighbours(array, 0)
    occupancy = [Occupancy(rng.integers(0, 4, SMALL), rng.random(SMALL) < 0.6) for _ in CROSS]
    seen = [
        volumes.sheared(volumes.visibility(volumes.occupancy(*one, FOUR.num_labels), SLACK), -m, -n, True)
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
    got = squared_cost(array, occupancy)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    assert (got != squared_cost(array)).any()


def test_mean_of_opposite_views_on_demand(rng: np.random.Generator) -> None:
    array = random_cross(rng, 3)
    got = squared_cost(array, smaller=False)
    own = array[0].image.astype(np.float64)
    parts = [volumes.truncated_error(own, [pictures_at(array, k)], SQUARED_LIMIT) for k in (1, 2)]
    inside = [~np.isnan(pictures_at(array, k)[..., 0]) for k in (1, 2)]
    expected = filled(volumes.photometric_cost(parts, inside) / SQUARED_LIMIT)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    assert (squared_cost(array) <= got + 1e-6).all()


def test_regions_of_every_window_count_alike(rng: np.random.Generator) -> None:
    shape = (20, 30)
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    array = array_of(image, np.roll(image, -1, axis=1))
    nothing = np.zeros(shape, np.int64)
    windows = Window(3, 2, 1), Window(6, 4, 2)
    arms = [cross_arms(image // 16, window) for window in windows]
    near, everything = neighbours(array, 0), slice(0, shape[0])
    comparison = Comparison(array, FOUR, COSTS["census"])

    def _cost(*chosen: int) -> NDArray[np.float32]:
        some = [arms[k] for k in chosen], [windows[k] for k in chosen]
        band = Band(nothing, FOUR.num_labels)
        return photometric_cost(comparison, 0, near, *some, nothing, band, None, everything)

    both, first, second = (_cost(*chosen)[:, 15:] for chosen in ((0, 1), (0,), (1,)))
    np.testing.assert_allclose(both, 0.5 * (first + second), atol=1e-5)
    assert (first != second).any()


def test_band_follows_the_surface(rng: np.random.Generator) -> None:
    """Costs of a few labels around a base surface are those of the whole volume, cut at its jumps."""
    shape, labels = (16, 30), DisparityLabels(0.0, 1.0, 12)
    image = rng.integers(60, 200, (*shape, 3)).astype(np.uint8)
    array = array_of(image, np.roll(image, -2, axis=1))
    base = np.where(np.indices(shape)[1] < 14, 3, 8) + np.indices(shape)[0] // 8
    occupancy = [Occupancy(base, rng.random(shape) < 0.5) for _ in array]
    arms, window = cross_arms(np.zeros((*shape, 3), np.uint8), Window(7, 7, 1)), Window(7, 7, 1)
    comparison, near = Comparison(array, labels, COSTS["census"]), neighbours(array, 0)
    bands = Band(np.zeros(shape, np.int64), labels.num_labels), Band(base - 2, 5)
    whole, part = (
        photometric_cost(comparison, 0, near, [arms], [window], base, band, occupancy, slice(0, shape[0]))
        for band in bands
    )
    np.testing.assert_allclose(part, volumes.banded(whole, base - 2, 5, np.nan), atol=2e-4)


FACTORS = np.array([0.8, 0.9, 1.1])


def shifted_pair(by: int) -> CameraArray:
    """Return a picture and the same moved to the left, with other levels in each channel."""
    levels = np.random.default_rng(213).integers(40, 200, (30, 60, 3)).astype(np.uint8)
    other = np.rint(np.roll(levels, -by, axis=1) * FACTORS).astype(np.uint8)
    return array_of(levels, other)


def test_gains_are_those_of_what_both_see() -> None:
    array = shifted_pair(3)
    surface = Occupancy(np.full(array.shape, 3), np.ones(array.shape, np.bool_))
    found = gains(array, LABELS, surface)
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
    found = gains(array, LABELS, Occupancy(np.full(array.shape, 3), supported))
    np.testing.assert_array_equal(found, 1.0)


@pytest.mark.parametrize("dark", [0, 1])
def test_surfaces_are_those_of_equal_exposures(dark: int) -> None:
    left, right, truth = pair_of_planes()
    images = [left, right]
    images[dark] = np.rint(images[dark] * np.array([0.85, 0.8, 0.75])).astype(np.uint8)
    tasks = (
        ((left, right), StereoSettings()),
        (images, StereoSettings()),
        (images, StereoSettings(exposures=False)),
    )
    found = [reconstruct(array_of(*views), LABELS, settings) for views, settings in tasks]
    bad = [float((np.abs(one.surfaces[0].disparity - truth) > 1.0).mean()) for one in found]
    assert bad[1] < bad[0] + 0.001 < bad[2]
    np.testing.assert_array_equal(found[1].array[dark].image, images[dark]), "views stay as they are"
