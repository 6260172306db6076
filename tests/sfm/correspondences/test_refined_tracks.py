"""Tracks between two frames find their place below the pixel."""

import numpy as np

from sfm.correspondences.refined_tracks import MAX_TRACK_ERROR_PX, refined_tracks
from sfm.model import Correspondences
from tests.sfm.textures import picture, shifted, texture


def test_rounded_tracks_find_the_shift_of_the_picture() -> None:
    """Whole pixels in the first frame, hundredths in the second; what is far from its track stays with it."""
    shift = np.array([1.3, -0.6])
    luma = texture(3)
    first, second = picture(luma, 60, 80), shifted(luma, 60, 80, (1.3, -0.6))
    places = np.array([[20.0, 20.0], [30.5, 24.0], [40.0, 33.5], [2.0, 2.0]])
    rounded = Correspondences(places, places + np.rint(2 * shift) / 2, np.zeros(4))
    found = refined_tracks(first, second, rounded)
    np.testing.assert_array_equal(found.first, np.rint(places))
    np.testing.assert_allclose(found.motion[:3], np.tile(shift, (3, 1)), atol=0.03)
    np.testing.assert_array_equal(found.motion[3], rounded.motion[3])  # no room for a neighbourhood
    wrong = Correspondences(places[:1], places[:1] + shift + 1.5 * MAX_TRACK_ERROR_PX, np.zeros(1))
    np.testing.assert_allclose(refined_tracks(first, second, wrong).motion, wrong.motion)
