"""What groups without key frame cost, by lost points."""

import pytest

from benchmarks.searches.lost_points import Ending, best_share, saved

FOUND = [
    Ending("a", 0.1, -0.5),
    Ending("a", 0.3, -0.1),
    Ending("a", 0.4, 0.3),
    Ending("b", 0.2, -0.4),
    Ending("b", 0.6, 0.2),
]


def test_clips_weigh_the_same() -> None:
    """However many groups they have."""
    assert saved(FOUND, 0.5) == pytest.approx((0.1 + 0.2) / 2)
    assert saved(FOUND, 0.0) == 0.0


def test_the_best_share_parts_what_saves_from_what_costs() -> None:
    """It lies between two groups."""
    assert best_share(FOUND) == pytest.approx(0.35)
    assert best_share([one for one in FOUND if one.cost < 0]) == pytest.approx(0.3)
    assert best_share([one for one in FOUND if one.cost > 0]) == pytest.approx(0.2)
