"""Propagation along edges: on pictures that shift, zoom and hide each other, from a handful of points."""

import numpy as np
import pytest

from dvc.arrays import Bytes, Floats
from sfm.correspondences import epipolar_search, point_matching
from sfm.correspondences.epipolar_search import EpipolarSearch
from sfm.correspondences.point_matching import find_edges, propagate
from sfm.correspondences.spline_sampling import half_pixel_samples, spline, spline_coefficients
from sfm.correspondences.subpixel import window
from sfm.estimation.epipolar import epipoles
from sfm.scene_model import Correspondences
from tests.reference import sfm_neighbourhoods, sfm_propagation
from tests.sfm.textures import forwards, picture, shifted, sideways, texture
from tests.twins import Choose

HEIGHT, WIDTH = 96, 128
TEXTURE = texture(21, 6.0, 24.0, 40.0)
STILL = picture(TEXTURE, HEIGHT, WIDTH)
SHIFT = np.array([6.4, 0.0])
MOVED = shifted(TEXTURE, HEIGHT, WIDTH, (6.4, 0.0))
SIDEWAYS = EpipolarSearch(STILL, MOVED, sideways())
SEEDS = np.array([[30.0, 30.0], [60.0, 50.0], [90.0, 70.0], [40.0, 75.0]])


def known(first: Floats, second: Floats) -> Correspondences:
    """Return correspondences without errors."""
    return Correspondences(first, second, np.zeros(len(first)))


def test_a_shift_spreads_over_the_frame() -> None:
    """From four points hundreds grow, all within 0.1 px and on their epipolar lines; the four come first."""
    given = known(SEEDS, SEEDS + SHIFT)
    found = propagate(SIDEWAYS, given)
    assert len(found) > 800
    np.testing.assert_array_equal(found.first[:4], given.first)
    np.testing.assert_array_equal(found.second[:4], given.second)
    assert np.abs(found.motion - SHIFT).max() < 0.1
    np.testing.assert_allclose(found.motion[:, 1], 0.0, atol=1e-9)
    assert len(np.unique(found.first, axis=0)) == len(found)
    assert (found.first == np.rint(found.first)).all()
    shift = np.array([3.9, -5.2])  # epipolar lines of any direction are followed
    slanted = EpipolarSearch(STILL, shifted(TEXTURE, HEIGHT, WIDTH, (3.9, -5.2)), sideways((0.6, -0.8)))
    found = propagate(slanted, known(SEEDS, SEEDS + shift))
    assert len(found) > 800
    assert np.abs(found.motion - shift).max() < 0.1


def test_a_forward_motion_zooms() -> None:
    """At a zoom of 1.25 neighbourhoods are scaled, and points near the epipole are left out."""
    centre, zoom = np.array([64.0, 48.0]), 1.25
    b = picture(TEXTURE, HEIGHT, WIDTH, np.column_stack([np.eye(2) / zoom, centre * (1 - 1 / zoom)]))
    first = np.array([[40.0, 40.0], [80.0, 60.0], [64.0, 30.0]])
    second = centre + zoom * (first - centre)
    search = EpipolarSearch(STILL, b, forwards((64.0, 48.0)))
    found = propagate(search, known(first, second))
    assert len(found) > 600
    assert np.abs(found.second - centre - zoom * (found.first - centre)).max() < 0.2
    assert np.sqrt(((found.first - centre) ** 2).sum(axis=1)).min() >= 12.0
    shapes = search.facing_similarities(first, second)
    np.testing.assert_allclose(shapes, np.tile(zoom * np.eye(2), (3, 1, 1)), atol=1e-9)


def test_edges_along_epipolar_lines_are_left_out() -> None:
    rows = np.arange(HEIGHT)[:, None] + np.zeros(WIDTH)
    stripes = np.rint(128 + 80 * np.sin(rows / 3)).astype(np.uint8)
    found = propagate(EpipolarSearch(stripes, stripes, sideways()), known(SEEDS, SEEDS))
    assert len(found) == len(SEEDS)


def hidden_pair() -> tuple[Bytes, Bytes, Floats]:
    """Return two frames of a square that moves by 12 before a texture that moves by 4, and its mask."""
    front, dim = texture(22, 6.0, 20.0, 40.0), texture(23, 5.0, 12.0, 6.0)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frames = []
    for shift_back, shift_front in ((0.0, 0.0), (4.0, 12.0)):
        mask = (np.abs(x - 55 - shift_front) < 22) & (np.abs(y - 48) < 28)
        back = shifted(dim, HEIGHT, WIDTH, (shift_back, 0.0))
        frames.append(np.where(mask, shifted(front, HEIGHT, WIDTH, (shift_front, 0.0)), back))
    return frames[0], frames[1], (np.abs(x - 55) < 22) & (np.abs(y - 48) < 28)


def test_points_lie_on_the_surface_that_they_move_with() -> None:
    """Of points at the outline of the square, nearly all are on the side whose motion they have."""
    a, b, mask = hidden_pair()
    first = np.array([[55.0, 48.0], [45.0, 40.0], [65.0, 60.0], [100.0, 48.0], [20.0, 20.0], [100.0, 85.0]])
    motion = np.where(mask[first[:, 1].astype(int), first[:, 0].astype(int)], 12.0, 4.0)
    given = known(first, first + np.column_stack([motion, np.zeros(6)]))
    found = propagate(EpipolarSearch(a, b, sideways()), given)
    x, y = found.first.astype(int).T
    error = np.abs(found.motion[:, 0] - np.where(mask[y, x], 12.0, 4.0))
    outline = np.abs(np.abs(x - 55) - 21.5) < 3
    assert np.count_nonzero(outline & (np.abs(y - 48) < 28)) > 30
    assert (error < 1.0)[outline].mean() > 0.85
    assert (error < 0.2)[~outline].mean() > 0.98


def test_corners_settle() -> None:
    """Right corners stay as they are, wrong ones go, and those beside their surface move by one pixel."""
    a, b, mask = hidden_pair()
    search = EpipolarSearch(a, b, sideways())
    right_motion, wrong_motion = np.array([12.0, 0.0]), np.array([7.0, 0.0])
    inner = np.array([[50.0, 48.0], [62.0, 40.0]])
    right = search.settle_on_surfaces(known(inner, inner + right_motion))
    np.testing.assert_array_equal(right.first, inner)
    assert len(search.settle_on_surfaces(known(inner, inner + wrong_motion))) == 0
    beside = np.column_stack([np.full(30, 77.0), np.arange(33.0, 63.0)])
    settled = search.settle_on_surfaces(known(beside, beside + right_motion))
    x, y = settled.first.astype(int).T
    assert np.count_nonzero(x != 77) > 5
    assert mask[y, x][x != 77].all()


def test_no_epipolar_geometry_or_no_seeds() -> None:
    given = known(SEEDS, SEEDS + SHIFT)
    for matrix in (np.zeros((3, 3)), np.full((3, 3), np.nan)):
        assert propagate(EpipolarSearch(STILL, MOVED, matrix), given) is given
        assert len(EpipolarSearch(STILL, MOVED, matrix).settle_on_surfaces(given)) == 4
    assert len(propagate(SIDEWAYS, Correspondences.empty())) == 0
    outside = np.array([[500.0, 5.0], [30.0, 30.0], [-3.0, 2.0]])
    odd = known(outside, np.array([[5.0, 5.0], [np.nan, 0.0], [1.0, 1.0]]))
    np.testing.assert_array_equal(propagate(SIDEWAYS, odd).first, odd.first)
    assert len(SIDEWAYS.settle_on_surfaces(odd)) == 0
    with pytest.raises(ValueError, match="one shape"):
        EpipolarSearch(STILL, MOVED[1:], sideways())


@pytest.mark.parametrize("shape", [(16, 16), (48, 64)])
def test_frames_without_edges(shape: tuple[int, int]) -> None:
    black = np.zeros(shape, dtype=np.uint8)
    given = known(np.array([[8.0, 8.0], [0.0, 15.0]]), np.array([[9.0, 8.0], [15.0, 15.0]]))
    assert len(propagate(EpipolarSearch(black, black, sideways()), given)) == 2
    noise = np.random.default_rng(8).integers(0, 256, (2, *shape), dtype=np.uint8)
    assert len(propagate(EpipolarSearch(noise[0], noise[1], sideways()), given)) < 10


# ---- kernels ----

SMALL = np.ascontiguousarray(STILL[20:50, 30:66]).astype(np.float64)
COEFFICIENTS = spline_coefficients(MOVED[20:50, 30:66])
SPLINE = spline(MOVED[20:50, 30:66])
GENERAL = forwards((90.0, -30.0)) + 0.3 * sideways((0.8, 0.6))
GENERAL = np.array(GENERAL / np.linalg.norm(GENERAL))
SEARCH = (1.5, 0.5, 1e-4)
LINE_SEARCH = epipolar_search.LineSearch(*SEARCH, min_error=4.0, error_share=0.05)
PAIR = epipolar_search.KeyPair(SMALL, SPLINE, half_pixel_samples(SPLINE), sideways(), epipoles(sideways())[0])


@pytest.mark.nojit
def test_errors_of_neighbourhoods(choose: Choose) -> None:
    target, weights, affine = SMALL[10:15, 12:17], window(2), np.array([[1.1, 0.2], [-0.1, 0.9]])
    direction = np.array([0.6, -0.8])

    def errors(x: float, y: float) -> Floats:
        line = epipolar_search.Line(np.array([x - 0.3, y + 0.4]), direction, affine)
        exact = choose(epipolar_search.neighbourhood_error)(target, SPLINE, line, 0.5, weights)
        rough = choose(epipolar_search.rough_error)(target, PAIR.halves, line, 0.5, weights)
        return np.array([exact, rough])

    for x, y in ((14.2, 12.7), (3.0, 2.9), (30.1, 26.0)):
        values = sfm_neighbourhoods.neighbourhood(COEFFICIENTS, x, y, affine, 2)
        exact, rough = errors(x, y)
        assert exact == pytest.approx(sfm_neighbourhoods.free_mean_error(target, values, weights), rel=1e-9)
        assert rough == pytest.approx(exact, rel=0.02)
    for x, y in ((1.0, 12.0), (34.0, 12.0), (14.0, 1.0), (14.0, 29.0)):
        assert (errors(x, y) == np.inf).all()


@pytest.mark.nojit
@pytest.mark.parametrize("fundamental", [sideways((0.6, 0.8)), -sideways(), forwards((90.0, -30.0)), GENERAL])
def test_epipolar_frames(choose: Choose, fundamental: Floats) -> None:
    """Foot, direction and similarity are those of the twin, up to the direction's sign of both."""
    line = epipolar_search.Line(np.empty(2), np.empty(2), np.empty((2, 2)))
    near, frame = np.array([20.0, 17.0]), choose(epipolar_search.epipolar_frame)
    assert frame(fundamental, epipoles(fundamental)[0], 15.0, 11.0, *near, line)
    expected = sfm_propagation.epipolar_frame(fundamental, 15, 11, near)
    np.testing.assert_allclose(line.foot, expected[0], atol=1e-9)
    np.testing.assert_allclose(np.abs(line.direction @ expected[1]), 1.0, atol=1e-9)
    np.testing.assert_allclose(line.affine, expected[2], atol=1e-5)
    at_epipole = forwards((3.0, 4.0)), np.array([3.0, 4.0, 1.0])
    assert not frame(*at_epipole, 3.0, 4.0, *near, line)
    affines = np.full((2, 2, 2), np.nan)
    points = np.array([[3.0, 4.0], [15.0, 11.0]])
    choose(epipolar_search.similarities)(*at_epipole, points, np.array([near, near]), affines)
    np.testing.assert_array_equal(affines[0], np.eye(2))
    assert np.isfinite(affines[1]).all()


@pytest.mark.nojit
def test_points_are_followed(choose: Choose) -> None:
    """Golden-section search ends where a fine full search does, and fails where that does."""
    weights, outcomes = window(2), []
    starts = (12, 14, 6.0), (20, 9, 6.9), (9, 20, 5.6), (15, 15, 1.0), (30, 12, 6.4), (22, 20, 6.2)
    for x, y, start in starts:
        near, found = np.array([x + start, y + 0.4]), np.empty(2)
        error = choose(epipolar_search.follow)(PAIR, x, y, near, weights, LINE_SEARCH, found)
        expected = sfm_propagation.follow(
            SMALL, COEFFICIENTS, sideways(), x, y, near, weights, SEARCH, 4.0, 0.05
        )
        outcomes.append(expected is not None)
        assert np.isfinite(error) == outcomes[-1]
        if expected is not None:
            np.testing.assert_allclose(found, expected[0], atol=0.006)
            assert error == pytest.approx(expected[1], abs=0.05)
    assert set(outcomes) == {True, False}


@pytest.mark.nojit
def test_rounds_of_propagation(choose: Choose) -> None:
    seeds = [(10, 10, np.array([16.4, 10.0])), (16, 14, np.array([23.0, 14.0]))]
    tries = np.zeros(SMALL.shape, dtype=np.int64)
    tries[9:18, 8:18] = 2 * find_edges(SMALL.astype(np.uint8))[9:18, 8:18]
    expected = sfm_propagation.propagate(
        SMALL, COEFFICIENTS, sideways(), tries, 3, window(2), SEARCH, 4.0, 0.05, seeds
    )
    first = np.zeros((SMALL.size + 2, 2), dtype=np.int64)
    second, errors = np.zeros((SMALL.size + 2, 2)), np.zeros(SMALL.size + 2)
    for k, (x, y, position) in enumerate(seeds):
        first[k], second[k] = (x, y), position
    points = epipolar_search.Points(first, second, errors)
    end = choose(point_matching.spread)(PAIR, tries.copy(), 3, window(2), LINE_SEARCH, 2, points)
    found = {tuple(p): q for p, q in zip(first[:end].tolist(), second[:end], strict=True)}
    assert end > 12
    assert found.keys() == expected.keys()
    np.testing.assert_allclose([found[p] for p in expected], list(expected.values()), atol=0.005)


@pytest.mark.nojit
def test_scores_of_sides(choose: Choose) -> None:
    first = np.array([[12, 14], [20, 12], [3, 15], [16, 3]])
    second = first + np.array([6.3, 0.1])
    normals = np.array([[1.0, 0.0], [0.6, -0.8], [0.8, 0.6], [0.0, 1.0]])
    scores = np.empty((4, 2))
    pair = PAIR._replace(fundamental=GENERAL, epipole=epipoles(GENERAL)[0])
    choose(epipolar_search.disagreement)(pair, first, second, normals, 4.0, window(1), 3.0, scores)
    expected = [
        sfm_propagation.disagreement(SMALL, COEFFICIENTS, GENERAL, tuple(p), q, n, 4.0, window(1), 3.0)
        for p, q, n in zip(first.tolist(), second, normals, strict=True)
    ]
    assert np.isnan(scores).any()
    assert np.isfinite(scores).sum() >= 4
    np.testing.assert_allclose(scores, expected, rtol=0.05, atol=0.004)
