"""Occupancy as maps, against volumes of voxels: agreement, support and visibility of several cameras."""

from dataclasses import replace

import numpy as np
import pytest

from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.stereo.surfaces import occupancy
from dvc.stereo.surfaces.occupancy import (
    Occupancy,
    agreement,
    neighbours,
    seen_elsewhere,
    shifts,
    supported,
)
from tests.reference import stereo_volumes as volumes
from tests.stereo.plane_scenes import BACKGROUND, LABELS, SCENE, Plane, reconstruction_of, square_lattice
from tests.twins import Choose

FEW = DisparityLabels(0.0, 1.0, 5)
SHAPE = (10, 13)
CENTRE = LatticePosition(0.0, 0.0)


def array_at(*positions: tuple[float, float], shape: tuple[int, int] = SHAPE) -> CameraArray:
    """Return black views."""
    black = np.zeros((*shape, 3), np.uint8)
    return CameraArray(tuple(ArrayView(f"{k}", black, LatticePosition(*p)) for k, p in enumerate(positions)))


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


def test_what_is_hidden_from_all_others_is_seen_nowhere() -> None:
    scene = reconstruction_of(SCENE, square_lattice(1), LABELS)
    maps = [LABELS.label(surface.disparity) for surface in scene.surfaces]
    everyone = seen_elsewhere(scene.array, LABELS, maps, 0)
    assert everyone.all(), "eight cameras around"
    pair = CameraArray(scene.array.views[:2])
    position = pair[1].position
    seen = seen_elsewhere(pair, LABELS, maps, 0)
    y, x = np.indices(seen.shape)
    u, v = x - int(position.m) * maps[0], y - int(position.n) * maps[0]
    inside = (u >= 0) & (u < seen.shape[1]) & (v >= 0) & (v < seen.shape[0])
    assert not seen[~inside].any()
    np.testing.assert_array_equal(seen[inside], maps[1][v[inside], u[inside]] == maps[0][inside])
    assert not seen[inside].all(), "some must be occluded"
    np.testing.assert_array_equal(seen, agreement(pair, LABELS, maps, (0, 1)).agreeing)


def test_inclined_surface_agrees_within_one_label() -> None:
    scene = reconstruction_of([Plane(2.0, slope=0.11)], [(0.0, 0.0), (1.0, 0.0)], LABELS)
    maps = [LABELS.label(surface.disparity) for surface in scene.surfaces]
    seen = agreement(scene.array, LABELS, maps, (0, 1)).agreeing
    x = np.arange(seen.shape[1])
    assert seen[:, x - maps[0][0] >= 0].all()


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


def test_background_alone_is_supported_but_for_the_border() -> None:
    scene = reconstruction_of([BACKGROUND], [(0.0, 0.0), (1.0, 0.0)], LABELS)
    maps = [LABELS.label(surface.disparity) for surface in scene.surfaces]
    kept = supported(scene.array, LABELS, maps, 0)
    np.testing.assert_array_equal(kept, np.indices(kept.shape)[1] >= BACKGROUND.disparity)
