"""Groups that are decoded at the same time: in order, as far ahead as there is room, up to what ends them."""

from collections.abc import Iterator, Sequence

import pytest

from decoder.processes import DecodingProcess
from decoder.scheduler import CHAINS_PER_PROCESS, GroupsInFlight, StreamGroups
from decoder.tasks import GroupTask
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord
from dvc.video import Frame
from tests.clips import moving_texture

KEY: Frame = moving_texture(1, 16, 16)[0]


def chain(number: int) -> list[GroupTask]:
    """Return a group that is a key frame."""
    return [GroupTask(b"", number, number, None, KEY, GopRecord(1, b"x"), Form.BUFFERED)]


def damaged(count: int, seen: list[int]) -> Iterator[Sequence[GroupTask]]:
    """Give some groups, and then what is wrong with the stream; note what was given."""
    for number in range(count):
        seen.append(number)
        yield chain(number)
    raise BitstreamError("broken")


def test_nothing_is_decoded_where_there_is_nothing() -> None:
    """No process is started for that."""
    assert list(GroupsInFlight(StreamGroups([], 1), 1).decode()) == []


@pytest.mark.parametrize("jobs", [1, 3])
def test_damage_comes_after_the_groups_before_it(jobs: int) -> None:
    """And no more is read of a stream than there is room for."""
    seen: list[int] = []
    groups = GroupsInFlight(StreamGroups(damaged(20, seen), jobs), jobs).decode()
    assert next(groups).first_index == 0
    assert seen == list(range(CHAINS_PER_PROCESS * jobs))
    found = []
    with pytest.raises(BitstreamError, match="broken"):
        found.extend(group.first_index for group in groups)
    assert found == list(range(1, 20))


class Interrupted(StreamGroups):
    """A source that is interrupted while it waits."""

    def wait(self, processes: Sequence[DecodingProcess]) -> list[DecodingProcess]:
        """Wait in vain."""
        raise KeyboardInterrupt


def test_what_is_decoded_comes_before_an_interrupt() -> None:
    """Whatever waits is given up."""
    open_end = GroupTask(b"", 2, 2, None, None, GopRecord(1, b"", b"", (b"x",)), Form.BUFFERED)
    groups = GroupsInFlight(Interrupted([chain(0), chain(1), [open_end]], 2), 2).decode()
    assert [next(groups).first_index, next(groups).first_index] == [0, 1]
    with pytest.raises(KeyboardInterrupt):
        next(groups)
