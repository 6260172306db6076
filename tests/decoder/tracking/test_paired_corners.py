"""Corners beside correspondences: sub-pixel peaks, and which are chosen."""

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.paired_corners import choose_paired_corners, strongest_nearby
from dvc.corners import corner_response
from sfm.scene_model import Correspondences

MOTION = np.array([4.0, 2.0])
ASIDE = np.array([1.0, 0.0])


def spots(points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Draw a round spot at each point of a small frame."""
    rows, columns = np.mgrid[:96, :128]
    luma = np.full(rows.shape, 50.0)
    for x, y in points:
        luma += 150.0 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 4.0)
    drawn: NDArray[np.uint8] = np.rint(luma).astype(np.uint8)
    return drawn


def test_peaks_of_a_parabola_are_exact() -> None:
    """The peak of a quadratic response is found between pixels, from a pixel beside it."""
    rows, columns = np.mgrid[:40, :50]
    centre = np.array([20.3, 15.8])
    response = 100.0 - (columns - centre[0]) ** 2 - 2.0 * (rows - centre[1]) ** 2
    peaks, strength = strongest_nearby(response, np.array([[21.0, 15.0], [19.4, 17.2]]), 2)
    np.testing.assert_allclose(peaks, [centre, centre], atol=1e-12)
    assert (strength > 99).all()


def test_a_slope_has_no_peak() -> None:
    """Where the response rises out of the neighbourhood, or out of the frame, there is no strength."""
    response = np.add.outer(np.arange(30.0), np.arange(40.0)) + 1.0
    places = np.array([[20.0, 10.0], [39.0, 29.0], [-5.0, 90.0]])
    assert (strongest_nearby(response, places, 2)[1] == 0).all()
    assert strongest_nearby(response, np.empty((0, 2)), 2)[0].shape == (0, 2)


def test_the_peak_of_a_spot_is_found() -> None:
    """A spot is a corner where it is."""
    place = np.array([[60.4, 40.7]])
    peaks, _ = strongest_nearby(corner_response(spots(place), np.ones(5)), np.rint(place), 2)
    np.testing.assert_allclose(peaks, place, atol=0.15)


def test_corners_are_followed_not_points() -> None:
    """Points beside a spot are replaced by the spot, one point for each, and flat places are left out."""
    centres = np.array([[30.3, 30.6], [80.0, 40.2], [60.5, 70.0]])
    beside = np.concatenate([np.rint(centres), np.rint(centres) + ASIDE, [[15.0, 80.0]]])
    moved = beside + MOTION
    pairs = Correspondences(beside, moved, np.zeros(len(beside)))
    chosen = choose_paired_corners(pairs, spots(centres), spots(centres + MOTION), 10, 3.0)
    order = np.argsort(chosen.first[:, 0])
    np.testing.assert_allclose(chosen.first[order], centres[[0, 2, 1]], atol=0.15)
    np.testing.assert_allclose(chosen.second - chosen.first, np.tile(MOTION, (3, 1)), atol=0.1)
    middle = np.array([0.5])
    np.testing.assert_allclose(
        (chosen.corners(middle) - chosen.offsets(middle))[:, 0],
        0.5 * (chosen.pairs.first + chosen.pairs.second),
        atol=1e-9,
    )


def test_a_corner_that_wanders_is_no_pair() -> None:
    """A corner that is not at the same place relative to its point in both key frames is not followed."""
    centre = np.array([[30.0, 30.0]])
    pairs = Correspondences(centre - ASIDE, centre + ASIDE, np.zeros(1))
    assert len(choose_paired_corners(pairs, spots(centre), spots(centre), 10, 3.0)) == 0
