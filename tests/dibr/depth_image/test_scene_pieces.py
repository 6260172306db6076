"""How far from its views a scene may be looked at."""

import pytest

from dvc.dibr.depth_image.scene_pieces import ACROSS, BEYOND, bounds_around, bounds_of_one


def test_bounds_are_beyond_all_sides() -> None:
    """By a share of the longer side."""
    assert bounds_around(-1.0, 3.0, 0.0, 1.0) == (
        -1 - 4 * BEYOND,
        3 + 4 * BEYOND,
        -4 * BEYOND,
        1 + 4 * BEYOND,
    )
    assert bounds_around(0.0, 1.0, 2.0, 5.0) == (-3 * BEYOND, 1 + 3 * BEYOND, 2 - 3 * BEYOND, 5 + 3 * BEYOND)


def test_one_view_bears_some_parallax() -> None:
    """In pixels a share of the width, to all sides."""
    assert bounds_of_one(200, 5.0) == pytest.approx([-40 * ACROSS, 40 * ACROSS] * 2)
