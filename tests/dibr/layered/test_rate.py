"""Rate of several pieces: sums are kept, and what is hard gets more."""

import numpy as np

from dvc.dibr.layered.rate import Choices, allot
from dvc.images import picture_codec as codec

RNG = np.random.default_rng(0)
HARD, EASY = (codec.encode(128 + RNG.normal(size=(32, 32)) * size) for size in (40.0, 8.0))


def test_bytes_are_divided_by_what_they_are_worth() -> None:
    for total in (100, 500, 1000):
        found = allot([Choices((HARD,), (0,)), Choices((EASY,), (0,))], total)
        assert found is not None
        assert sum(found) == total
        assert found[0] > found[1]


def test_what_codes_need_beside_their_own_counts() -> None:
    assert allot([Choices((HARD,), (60,)), Choices((EASY,), (50,))], 100) is None
    found = allot([Choices((HARD,), (60,)), Choices((EASY,), (50,))], 110)
    assert found == [60, 50]


def test_the_cheaper_of_two_codes_is_taken() -> None:
    both = Choices((HARD, HARD), (200, 3))
    for multiplier in (1e-7, 1e-4, 1e-2):
        assert both.bytes_at_multiplier(multiplier) == 3 + HARD.bytes_at_multiplier(multiplier)


def test_everything_is_coded_where_there_is_room() -> None:
    found = allot([Choices((HARD,), (0,)), Choices((EASY,), (0,))], 10**6)
    assert found is not None
    assert sum(found) < 10**6


def test_where_nothing_but_what_is_needed_fits_there_is_no_code() -> None:
    """However much the first bits are worth."""
    dear = Choices((HARD, EASY), (40, 30), 1e6)
    assert dear.bytes_at_multiplier(10.0) > 40
    assert allot([dear, dear], 60) == [30, 30]
    assert allot([dear, dear], 59) is None
