"""What waits for a slow decoder, and what is left out: in order, bounded, and told."""

import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from fractions import Fraction
from itertools import groupby, pairwise

import pytest

from dvc.config import Live, ParityBuffer, VideoConfig, codec_config
from dvc.errors import VideoError
from dvc.video import Frame
from encoder.__main__ import _queue
from encoder.encoder_session import EncoderSession
from encoder.frame_queue import FrameQueue, PacedFrames
from tests.clips import moving_texture
from tests.waiting import Clock, wait_until

FRAMES = [Frame(frame.luma) for frame in moving_texture(40, 24, 32)]
NUMBERS = {id(frame): number for number, frame in enumerate(FRAMES)}


class Source:
    """A camera whose frames come when they are let go."""

    def __init__(self) -> None:
        self.num_read = 0
        self.failure: Exception | None = None
        self._allowed = threading.Semaphore(0)

    def __iter__(self) -> Iterator[Frame]:
        for frame in FRAMES:
            self._allowed.acquire()
            if self.failure is not None:
                raise self.failure
            self.num_read += 1
            yield frame

    def let_go(self, num_frames: int) -> None:
        self._allowed.release(num_frames)


def wait_for_frames(source: Source, num_read: int) -> None:
    """Wait until so many frames were read, and none more for a while."""
    wait_until(lambda: source.num_read >= num_read)
    time.sleep(0.02)
    assert source.num_read == num_read


def take(queue: FrameQueue, count: int) -> list[int | None]:
    return [None if frame is None else NUMBERS[id(frame)] for frame in (next(queue) for _ in range(count))]


def test_all_frames_come_in_order_and_then_the_end() -> None:
    assert [NUMBERS[id(frame)] for frame in FrameQueue(FRAMES, 1) if frame] == list(range(40))


def test_a_source_that_can_wait_is_read_no_further_than_the_queue_holds() -> None:
    source = Source()
    source.let_go(40)
    queue = FrameQueue(source, 5)
    assert source.num_read == 0
    assert take(queue, 1) == [0]
    wait_for_frames(source, 7)
    assert take(queue, 10) == list(range(1, 11))
    wait_for_frames(source, 17)
    assert (queue.left_out.frames, queue.left_out.gaps) == (0, 0)
    assert queue.close()


def test_frames_are_left_out_until_there_is_room_for_a_group() -> None:
    source = Source()
    queue = FrameQueue(source, 6, 4)
    source.let_go(1)
    assert take(queue, 1) == [0]
    source.let_go(10)  # six wait, four are left out
    wait_for_frames(source, 11)
    assert take(queue, 3) == [1, 2, 3]
    source.let_go(2)  # room for three is not enough for a group
    wait_for_frames(source, 13)
    assert take(queue, 1) == [4]
    source.let_go(5)  # four have room, the fifth does not
    wait_for_frames(source, 18)
    assert take(queue, 7) == [5, 6, None, 13, 14, 15, 16]
    assert (queue.left_out.frames, queue.left_out.gaps) == (7, 2)
    assert queue.left_out.named == [[7, 12], [17, 17]]


def test_what_the_source_fails_with_comes_after_its_frames() -> None:
    source = Source()
    queue = FrameQueue(source, 10)
    source.let_go(1)
    assert take(queue, 1) == [0]
    source.let_go(3)
    wait_for_frames(source, 4)
    source.failure = VideoError("cable")
    source.let_go(1)
    assert take(queue, 3) == [1, 2, 3]
    with pytest.raises(VideoError, match="cable"):
        next(queue)
    with pytest.raises(StopIteration):
        next(queue)


def test_large_frames_take_no_more_memory_unless_a_group_does() -> None:
    """By default 64 frames wait, 16 of four times 1920x1080, never less than a group."""

    def length(width: int, height: int, group_length: int) -> int:
        codec = codec_config(VideoConfig(width, height, 25, 1), gop={"length": group_length})
        paced = PacedFrames([], Fraction(25))
        return _queue(paced, Namespace(queue=None, leave_out=False), codec)._max_frames

    assert length(352, 288, 16) == length(1920, 1080, 16) == 64
    assert length(3840, 2160, 8) == 16
    assert length(4096, 4096, 16) == 16


def test_a_silent_source_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("encoder.frame_queue.MAX_CLOSING_S", 0.05)
    source = Source()
    queue = FrameQueue(source, 10)
    source.let_go(1)
    assert take(queue, 1) == [0]
    assert not queue.close()
    source.let_go(1)
    wait_until(queue.close)


@pytest.mark.parametrize("codec", ["2d", "3d-td", "3d-te"])
def test_groups_begin_anew_after_a_gap(codec: str) -> None:
    """The frame after a gap is a key frame by itself, and no group reaches over the gap."""
    config = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), codec)
    session = EncoderSession(config, Live() if codec == "3d-te" else ParityBuffer())
    given = [*FRAMES[:7], None, *FRAMES[20:29], None, *FRAMES[35:36], None, *FRAMES[38:]]
    groups = list(session.groups(given))
    covered = [[NUMBERS[id(frame)] for frame in (*group.wyner_ziv, group.key)] for group in groups]
    assert [number for group in covered for number in group] == [
        NUMBERS[id(frame)] for frame in given if frame is not None
    ]
    assert all(second == first + 1 for group in covered for first, second in pairwise(group))
    first = [number for number, group in enumerate(covered) if group[0] in (0, 20, 35, 38)]
    assert [covered[number] for number in first] == [[0], [20], [35], [38]]
    records = [session.encode(group).record for group in groups]
    assert all(records[number].key for number in first)


@pytest.mark.parametrize("codec", ["2d", "3d-te"])
def test_runs_of_frames_are_taken_as_they_come(codec: str) -> None:
    asked: list[int] = []

    def _asking() -> Iterator[Frame | None]:
        for number, frame in enumerate([*FRAMES[:4], None, *FRAMES[4:]]):
            asked.append(number)
            yield frame

    config = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), codec, gop={"length": 2})
    seen = [len(asked) for _ in EncoderSession(config).groups(_asking())]
    assert [length for length, _ in groupby(seen)][:4] == [1, 3, 5, 6]


def test_a_group_can_be_read_once_it_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("encoder.frame_queue.MAX_CLOSING_S", 0.05)
    short = FrameQueue(FRAMES[:2], 5)
    wait_until(lambda: short.holds(3))
    source = Source()
    queue = FrameQueue(source, 5)
    assert not queue.holds(3)
    source.let_go(2)
    wait_for_frames(source, 2)
    assert not queue.holds(3)
    source.let_go(1)
    wait_until(lambda: queue.holds(3))
    source.let_go(2)
    wait_until(lambda: queue.holds(8))
    assert not queue.close()
    source.let_go(1)
    wait_until(queue.close)


def behind_s(work_s: list[float], waiting_s: float = 0.0, reading_s: float = 0.0) -> float:
    """Return how far work of given times on frames falls behind 4 of them a second."""
    clock, cpu_clock = Clock(), Clock()

    def source() -> Iterator[Frame]:
        for _ in work_s:
            clock.now_s += waiting_s + reading_s
            cpu_clock.now_s += reading_s
            yield FRAMES[0]

    frames = PacedFrames(source(), Fraction(4), clock, cpu_clock)
    for _, spent_s in zip(frames, work_s, strict=True):
        clock.now_s += spent_s
    return frames.behind_s


@pytest.mark.parametrize(
    ("work_s", "waiting_s", "reading_s", "expected_s"),
    [
        ([0.25] * 8, 0.0, 0.0, 0.0),
        ([0.5] * 9, 0.0, 0.0, 2.0),
        ([0.5] * 5 + [0.0] * 20, 0.0, 0.0, 1.25),
        ([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0], 0.0, 0.0, 1.0),
        ([0.125] * 8, 0.125, 0.0, 0.0),
        ([0.0] * 8, 5.0, 0.0, 0.0),
        ([0.25] * 9, 0.0, 0.25, 2.0),
        ([9.0], 0.0, 0.0, 0.0),
        ([], 0.0, 0.0, 0.0),
    ],
)
def test_lateness_adds_up_and_is_made_good(
    work_s: list[float], waiting_s: float, reading_s: float, expected_s: float
) -> None:
    """Work that takes longer than a frame lasts adds up; shorter work and waiting for the source take off."""
    assert behind_s(work_s, waiting_s, reading_s) == expected_s
