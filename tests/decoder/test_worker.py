"""The order in which a decoding process does what it can: what others wait for comes first."""

from itertools import islice
from queue import SimpleQueue

import numpy as np
import pytest

from decoder.group import GroupDecoder
from decoder.tasks import Answered, GroupTask
from decoder.worker import MAX_ACTIVE_PX, LevelTurns, longest_way_first
from dvc.config import VideoConfig, codec_config
from dvc.stream import GopRecord

NO_BITS = np.zeros(0, np.uint8)


def answer(number: int, frame: int) -> Answered:
    return Answered(number, (frame, 0), NO_BITS)


def test_what_most_levels_depend_on_comes_first() -> None:
    """Of the same level the first group's answer comes first, of the same group the one that came first."""
    left = {0: 3, 1: 1, 2: 2, 3: 1}
    received: SimpleQueue[Answered] = SimpleQueue()
    messages = [answer(1, 1), answer(0, 3), answer(0, 1), answer(1, 2), answer(0, 2), answer(2, 0)]
    for message in messages:
        received.put(message)
    taken = list(islice(longest_way_first(received, lambda message: left[message.place[0]]), len(messages)))
    assert [(message.number, message.place[0]) for message in taken] == [
        (2, 0), (0, 2), (1, 2), (0, 3), (0, 1), (1, 1)
    ]  # fmt: skip


def test_what_comes_later_may_come_first() -> None:
    """A message that comes while others wait takes its place among them."""
    received: SimpleQueue[Answered] = SimpleQueue()
    taken = longest_way_first(received, lambda message: message.place[0])
    for frame in (1, 2):
        received.put(answer(0, frame))
    assert next(taken).place[0] == 2
    received.put(answer(5, 3))
    assert [message.place[0] for message in islice(taken, 2)] == [3, 1]


@pytest.mark.parametrize(("references", "wanted"), [("hierarchical", [1, 2, 4]), ("all", [1] * 7)])
def test_level_sizes_of_a_group(references: str, wanted: list[int]) -> None:
    """The middle frame comes before all others; without levels each frame comes alone."""
    config = codec_config(VideoConfig(32, 24, 25, 1), "2d", gop={"length": 8, "references": references})
    record = GopRecord(8, b"", b"", (b"",) * 7)
    task = GroupTask(b"", 1, 1, None, None, record, None)
    assert GroupDecoder(config).level_sizes(task) == wanted


def test_levels_begin_while_there_is_memory() -> None:
    """Those with most levels left come first; a level that is larger than all memory has it alone."""
    begun: list[int] = []
    turns = LevelTurns(lambda turn: begun.append(turn.number))
    half = MAX_ACTIVE_PX // 2
    turns.wait(0, 1, half)
    turns.wait(1, 2, half + 1)
    assert begun == [0]
    turns.wait(2, 3, half)
    assert begun == [0, 2]
    turns.end(0)
    assert begun == [0, 2]
    turns.end(2)
    assert begun == [0, 2, 1]
    turns.wait(3, 1, 3 * MAX_ACTIVE_PX)
    turns.wait(1, 1, 1)
    assert begun == [0, 2, 1, 1]
    turns.end(1)
    assert begun == [0, 2, 1, 1, 3]
    turns.wait(4, 5, 1)
    assert begun == [0, 2, 1, 1, 3]
    turns.end(3)
    assert begun == [0, 2, 1, 1, 3, 4]
