"""Items that are lent."""

import pytest

from dvc.pool import Pool


def test_items_are_made_where_none_is_idle_and_come_back() -> None:
    """Two at once are two; whoever comes later, or after a failure, gets one of them."""
    made: list[list[int]] = []

    def make() -> list[int]:
        made.append([])
        return made[-1]

    pool = Pool(make)
    with pool.lent() as first, pool.lent() as second:
        assert first is not second
    with pytest.raises(KeyError), pool.lent():
        raise KeyError
    with pool.lent() as third, pool.lent() as fourth:
        assert third is not fourth
    assert len(made) == 2
