"""Pictures for people: colours say what they stand for, panels keep their content."""

import numpy as np

from dvc.web.drawing import (
    BAD,
    GOOD,
    UNKNOWN,
    colour_counts,
    colour_disparity,
    colour_error,
    disparity_legend,
    in_rows,
    with_title,
)


def test_near_is_brighter() -> None:
    """Colours get brighter from far to near; unknown pixels are grey."""
    picture = colour_disparity(np.array([[np.nan, -2.0, 0.0, 2.0, 9.0]]), -2.0, 2.0)
    luma = picture[0].astype(np.float64) @ [0.114, 0.587, 0.299]
    assert tuple(picture[0, 0]) == UNKNOWN
    assert luma[1] < luma[2] < luma[3]
    assert luma[3] == luma[4]


def test_constant_disparity_has_one_colour() -> None:
    """A range of no width divides by nothing."""
    picture = colour_disparity(np.full((3, 4), 5.0), 5.0, 5.0)
    assert (picture == picture[0, 0]).all()


def test_errors_have_three_colours() -> None:
    """Right, nearly bad and bad pixels differ, and what does not count is grey."""
    error = np.array([[0.4, 0.6, 1.0, 1.01, np.inf, 0.0]])
    counted = np.array([[True, True, True, True, True, False]])
    picture = colour_error(error, counted)
    assert tuple(picture[0, 0]) == GOOD
    assert tuple(picture[0, 1]) == tuple(picture[0, 2])
    assert tuple(picture[0, 3]) == tuple(picture[0, 4]) == BAD
    assert tuple(picture[0, 5]) == UNKNOWN


def test_counts_are_even_steps() -> None:
    """0 is black, the highest count white, and others lie evenly between."""
    assert colour_counts(np.array([[0, 1, 2, 3]]), 3)[0, :, 0].tolist() == [0, 85, 170, 255]


def test_panels_keep_pictures() -> None:
    """Titles are put above, rows below each other, and no pixel of a picture changes."""
    rng = np.random.default_rng(3)
    pictures = [rng.integers(0, 256, (20, 90, 3)).astype(np.uint8) for _ in range(3)]
    joined = in_rows([with_title(picture, "title") for picture in pictures], 2)
    assert joined.shape == (2 * 46 + 8, 2 * 90 + 8, 3)
    np.testing.assert_array_equal(joined[26:46, :90], pictures[0])
    np.testing.assert_array_equal(joined[26:46, 98:], pictures[1])
    np.testing.assert_array_equal(joined[54 + 26 :, :90], pictures[2])
    assert (joined[54:, 98:] == 255).all()
    assert disparity_legend(200, 0.0, 15.0).shape[1] == 200
