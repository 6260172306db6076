"""More corners matched, where the motion of their neighbours and the epipolar geometry expect them."""

import numpy as np

from sfm.correspondences import densification
from sfm.correspondences.corner_matching import detect_corners, match_corners
from sfm.correspondences.densification import densify
from sfm.correspondences.epipolar_search import EpipolarSearch
from sfm.scene_model import Correspondences
from tests.sfm.textures import picture, shifted, sideways, texture

HEIGHT, WIDTH = 120, 160
TEXTURE = texture(31, 6.0, 20.0, 30.0)
A = picture(TEXTURE, HEIGHT, WIDTH)
B = shifted(TEXTURE, HEIGHT, WIDTH, (7.3, 0.0))
CORNERS = detect_corners(A, 200), detect_corners(B, 200)


def test_left_out_corners_come_back() -> None:
    """From every fifth match most others are found again, all but a few right; the given come first."""
    matches = match_corners(A, B, *CORNERS)
    matches = matches[np.abs(matches.motion - [7.3, 0.0]).max(axis=1) < 0.15]
    given = matches[np.arange(0, len(matches), 5)]
    found = densify(EpipolarSearch(A, B, sideways()), *CORNERS, given)
    np.testing.assert_array_equal(found.first[: len(given)], given.first)
    assert len(found) > 0.75 * len(matches)
    assert (np.abs(found.motion - [7.3, 0.0]).max(axis=1) < 0.15).mean() > 0.98


def test_epipolar_geometry_is_enforced() -> None:
    """Nothing is added that contradicts F."""
    matches = match_corners(A, B, *CORNERS)
    given = matches[np.arange(0, len(matches), 5)]
    assert len(densify(EpipolarSearch(A, B, sideways((0.0, 1.0))), *CORNERS, given)) == len(given)


def test_nothing_to_go_by() -> None:
    """Too few matches, no usable F or no corners left give back what was given."""
    matches = match_corners(A, B, *CORNERS)
    few = matches[np.arange(3)]
    assert densify(EpipolarSearch(A, B, sideways()), *CORNERS, few) is few
    assert densify(EpipolarSearch(A, B, np.zeros((3, 3))), *CORNERS, matches) is matches
    none = np.empty((0, 2))
    assert densify(EpipolarSearch(A, B, sideways()), none, CORNERS[1], matches) is matches
    assert densify(EpipolarSearch(A, B, sideways()), CORNERS[0], none, matches) is matches
    flat = np.full((HEIGHT, WIDTH), 9, dtype=np.uint8)
    assert len(densify(EpipolarSearch(flat, flat, sideways()), *CORNERS, matches)) == len(matches)
    assert len(densify(EpipolarSearch(A, B, sideways()), *CORNERS, Correspondences.empty())) == 0


def test_variances_are_of_squares_around_points() -> None:
    """Zero where the square leaves the picture, by however little."""
    points = np.array(
        [[20.0, 30.0], [3.0, 3.0], [2.0, 60.0], [WIDTH - 4.0, HEIGHT - 4.0], [50.0, HEIGHT - 3.0]]
    )
    found = densification.neighbourhood_variances(A, points, 3)
    squares = [A[int(y) - 3 : int(y) + 4, int(x) - 3 : int(x) + 4].astype(np.float64) for x, y in points]
    expected = [square.var() if square.shape == (7, 7) else 0.0 for square in squares]
    assert np.count_nonzero(expected) == 3
    np.testing.assert_allclose(found, expected)
