"""Lattices: exact recovery, cameras on a line, orientation, and positions from centres."""

from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.rectification.camera_lattice import Lattice, assign_positions, fit_lattice, mean_orientation
from dvc.stereo.rectification.rectified_array import rectify
from tests.stereo.rigs import random_rig

GRID = [(float(m), float(n)) for n in range(3) for m in range(4)]
FACING = np.eye(3)
seeds = st.integers(0, 10**6)


def rig_of(seed: int, places: object, turn: float = 0.15) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of cameras, and their mean orientation."""
    rig = random_rig(seed, np.array(places, float).tolist(), turn=turn)
    return np.stack([camera.centre for camera in rig]), mean_orientation([camera.R for camera in rig])


@settings(max_examples=40)
@given(seeds)
def test_grid_is_recovered_exactly(seed: int) -> None:
    kept = np.random.default_rng(seed).permutation(len(GRID))[:6]
    places = np.array([GRID[k] for k in kept])
    if np.linalg.matrix_rank(places - places[0]) < 2:
        return
    centres, orientation = rig_of(seed, places)
    lattice, _ = fit_lattice(centres, places, orientation)
    found = lattice.coordinates(centres)
    np.testing.assert_allclose(found, np.column_stack([places, np.zeros(len(places))]), atol=1e-11)


@settings(max_examples=40)
@given(seeds, st.sampled_from([(1.0, 0.0), (0.0, 1.0), (2.0, 1.0), (-1.0, 3.0)]))
def test_line_gets_a_perpendicular_vector_of_its_cells(seed: int, step: tuple[float, float]) -> None:
    places = np.outer(np.arange(4.0), step)
    centres, orientation = rig_of(seed, places, 0.05)
    lattice, _ = fit_lattice(centres, places, orientation)
    lengths = np.linalg.norm(lattice.v1), np.linalg.norm(lattice.v2)
    assert abs(lattice.v1 @ lattice.v2) < 1e-12 * lengths[0] * lengths[1]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)
    assert np.cross(lattice.v1, lattice.v2) @ orientation[2] > 0
    np.testing.assert_allclose(lattice.coordinates(centres)[:, :2], places, atol=1e-11)


def test_single_camera_has_steps_along_its_picture() -> None:
    lattice, _ = fit_lattice(np.ones((1, 3)), np.zeros((1, 2)), FACING)
    np.testing.assert_allclose([lattice.origin, lattice.v1, lattice.v2], [[1, 1, 1], [1, 0, 0], [0, 1, 0]])


def test_basis_does_not_depend_on_the_unit_of_the_world() -> None:
    small, large = (
        Lattice(np.zeros(3), unit * np.array([2.0, 0, 0]), unit * np.array([1.0, 3.0, 0])).basis
        for unit in (1, 10)
    )
    np.testing.assert_allclose(large, 10 * small)
    assert np.linalg.norm(small[:, 2]) == pytest.approx(np.sqrt(6.0))


@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_mirrored_places_are_turned_to_the_scene(signs: tuple[int, int]) -> None:
    centres, orientation = rig_of(3, GRID)
    lattice, places = fit_lattice(centres, np.array(GRID) * signs, orientation)
    np.testing.assert_allclose(places, GRID, atol=1e-12)
    np.testing.assert_allclose(lattice.coordinates(centres)[:, :2], GRID, atol=1e-11)
    assert np.cross(lattice.v1, lattice.v2) @ orientation[2] > 0


@settings(max_examples=25)
@given(seeds)
def test_whole_numbers_are_found(seed: int) -> None:
    centres, orientation = rig_of(seed, GRID)
    lattice, places = assign_positions(centres, orientation)
    np.testing.assert_allclose(places - places[0], np.array(GRID), atol=1e-12)
    assert (places == 0).all(axis=1).sum() == 1
    np.testing.assert_allclose(lattice.coordinates(centres)[:, :2], places, atol=1e-10)


@pytest.mark.parametrize(("ratio", "is_line"), [(0.04, True), (0.08, False)])
def test_what_is_narrow_is_a_line(ratio: float, is_line: bool) -> None:
    across, down = np.arange(6.0) - 2.5, np.array([1.0, -1, 0, 0, -1, 1])
    down *= ratio * np.linalg.norm(across) / np.linalg.norm(down)
    _, places = assign_positions(np.column_stack([across, down, np.full(6, 2.0)]), FACING)
    assert bool(np.ptp(places[:, 1]) == 0.0) == is_line


@pytest.mark.parametrize("step", [(1.0, 0.0), (0.0, 1.0)])
def test_row_or_column_with_a_gap(step: tuple[float, float]) -> None:
    """Cameras 0, 1, 3 of a line are at -1, 0, 2 of a row or of a column."""
    _, places = assign_positions(*rig_of(5, np.outer([0.0, 1.0, 3.0], step), 0.02))
    np.testing.assert_allclose(places, np.outer([-1.0, 0.0, 2.0], step), atol=1e-12)


def test_pair_is_left_and_right_by_its_centres() -> None:
    centres, orientation = rig_of(2, [(0.0, 0.0), (1.0, 0.0)], 0.02)
    for order, expected in ((centres, 1.0), (centres[::-1], -1.0)):
        np.testing.assert_array_equal(assign_positions(order, orientation)[1], [[0, 0], [expected, 0]])


def test_irregular_centres_get_real_places() -> None:
    """Centres without a lattice have real-valued places in perpendicular units of a neighbour's distance."""
    rng = np.random.default_rng(7)
    points = np.array(GRID) * 1.3 + rng.uniform(-0.4, 0.4, (12, 2))
    centres = np.column_stack([points, np.full(12, 2.0)])
    lattice, places = assign_positions(centres, FACING)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.diag(np.full(12, np.inf))
    unit = np.median(apart.min(axis=1))
    np.testing.assert_allclose(np.stack([lattice.v1, lattice.v2]), unit * np.eye(3)[:2], atol=1e-12)
    np.testing.assert_allclose(lattice.coordinates(centres)[:, :2], places, atol=1e-10)
    assert (np.abs(places - np.rint(places)).max(axis=1) > 0.01).sum() > 8


@pytest.mark.parametrize(("aside", "are_kept"), [(0.02, True), (0.05, False)])
def test_centres_off_their_places_become_real_valued(aside: float, are_kept: bool) -> None:
    """Within the tolerance, 1/80 of these cells, the given places stay; beyond it the projections do."""
    K, centres = np.diag([100.0, 100.0, 1.0]), [0.0, 1.0, 2.0 + aside]
    rig = [Camera(f"{x}.png", K, np.eye(3), np.array([-x, 0.0, 0.0]), (160, 120)) for x in centres]
    places = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    found = np.array(rectify(rig, [LatticePosition(*place) for place in places]).positions)
    assert np.array_equal(found, places) == are_kept
    np.testing.assert_allclose(found, places, atol=aside)


@pytest.mark.parametrize(
    ("centres", "places", "message"),
    [
        ([[0, 0, 0], [0, 0, 0]], [[0, 0], [1, 0]], "one point"),
        ([[0, 0, 0], [0, 0, 1]], [[0, 0], [1, 0]], "one behind the other"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 0], [1, 0], [0, 1]], "on a line"),
    ],
)
def test_degenerate_centres(centres: list, places: list, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        fit_lattice(np.array(centres, float), np.array(places, float), FACING)


@pytest.mark.parametrize(("aside", "is_refused"), [(0.04, True), (0.06, False)])
def test_cameras_almost_one_behind_the_other(aside: float, is_refused: bool) -> None:
    centres, places = np.array([[0, 0, 0], [aside, 0, 1.0]]), np.array([[0.0, 0], [1, 0]])
    expectation = pytest.raises(ConfigError, match="one behind the other") if is_refused else nullcontext()
    with expectation:
        assert fit_lattice(centres, places, FACING)[0].v1[0] > 0.0
