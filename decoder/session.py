"""Decoder of figure 5.1: stream or connection in; decoded groups of pictures, and their costs, out.

A stream and a live encoder are decoded alike: a source gives groups in order of display, processes decode
them, and their requests go to the source. Requests for frames of a stream never come here: the process finds
the answers in the record of the group.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import count
from multiprocessing.connection import wait
from typing import Any, cast

from decoder.group_tasks import Answered, Bits, DecodedGroup, GroupTask, Losses, Reader, naming_group
from decoder.live import LiveGroups, LiveSource
from decoder.processes import DecodingProcess, decoding_process
from decoder.side_information.protocol import ReferenceFrame
from dvc.config import CodecConfig, encode_config
from dvc.errors import BitstreamError, ConnectionLostError
from dvc.feedback import Gop, ParityAnswer, Readable, max_open_gops
from dvc.keyframes import KeyFrameDecoder
from dvc.limits import Limits
from dvc.slepian_wolf import ParityRequest, Place
from dvc.stream import Form, GopRecord, check_times, frame_times_s

GROUPS_PER_PROCESS = 4
"""Number of groups per process: one in work, and more for a slow earlier group."""


def decode_stream(
    config: CodecConfig,
    reader: Reader,
    jobs: int = 1,
    frames: range | None = None,
    limits: Limits | None = None,
    losses: Losses | None = None,
) -> Iterator[DecodedGroup]:
    """Decode a stream group by group; the same bytes for any number of jobs.

    Parameters
    ----------
    config : CodecConfig
        The stream's configuration, or that with the decoder's own choice of side information.
    reader : StreamReader or RecordingReader
        The stream, or the segments of a recording.
    jobs : int, optional
        Processes that decode groups at the same time.
    frames : range, optional
        Display positions of the frames that are wanted, all by default; other groups are skipped.
    limits : Limits, optional
        Most that may be spent; those of the program by default.
    losses : Losses, optional
        Records the losses by damage, and decoding continues behind it; without it damage ends decoding.

    Returns
    -------
    iterator of DecodedGroup
        In display order; it raises `BitstreamError` at the first damage, after all groups before it.
    """
    limits = limits or Limits()
    check_stream(config, reader, jobs, frames, limits)
    tasks = stream_tasks(config, reader, frames, limits, losses)
    return GroupsInFlight(StreamGroups(tasks, jobs), jobs, losses).decode()


def check_stream(
    config: CodecConfig, reader: Reader, jobs: int, frames: range | None, limits: Limits
) -> None:
    """Refuse a stream with too many frames, or with too large ones for the number of processes."""
    num_frames = reader.num_frames if frames is None else len(frames)
    limits.check_frames(num_frames, reader.num_bytes, config.video)
    num_waiting = (GROUPS_PER_PROCESS * jobs + 1) * config.gop.length
    limits.check_memory(config.video, min(num_waiting, num_frames) if num_frames else num_waiting, jobs)


def stream_tasks(
    config: CodecConfig,
    reader: Reader,
    frames: range | None = None,
    limits: Limits | None = None,
    losses: Losses | None = None,
) -> Iterator[GroupTask]:
    """Read a stream, and decode its key frames; continue behind damage if losses are recorded."""
    limits = limits or Limits()
    first_group = 0
    if frames is not None:  # the chain of key frames of the first frame begins there or later
        back = config.key.intra_period + config.gop.length if config.key.predicted else 0
        first_group = max(reader.index.gop_of(max(frames.start - back, 0)) - 1, 0)
    tasks = _Tasks(config, reader.index.first_frame(first_group) if first_group else 0)
    if first_group:
        reader.seek_gop(first_group)
    first_index = tasks.next_index
    for number, record, damage in _records(reader, first_group, losses):
        if first_index == tasks.next_index and number > 0 and record.predicted:
            tasks.skip(record.num_frames)
            first_index = tasks.next_index
            continue  # its chain begins before the first group that was read
        index = tasks.next_index
        try:
            if damage is not None:
                raise damage
            task = tasks.add(number, record, reader.form)
        except BitstreamError as err:
            if losses is None:
                raise
            losses.add(range(index, index + record.num_frames), err)
            tasks.skip(index + record.num_frames - tasks.next_index)
            continue
        limits.check_frames(task.last_index + 1 - first_index, reader.num_bytes, config.video)
        is_whole = task.before is not None or task.record.num_frames == 1
        if losses is not None and not is_whole:
            losses.add(range(index, task.last_index), "the key frame before is lost")
            task, is_whole = task.key_alone(), True
        if is_whole and (frames is None or task.last_index >= frames.start):
            yield task
        if frames is not None and task.last_index + 1 >= frames.stop:
            return


def _records(
    reader: Reader, first: int, losses: Losses | None
) -> Iterator[tuple[int, GopRecord, BitstreamError | None]]:
    """Number the groups of a stream; of damaged ones nothing but the number of frames is left."""
    for number in count(first):
        damage: BitstreamError | None = None
        try:
            record = next(iter(reader), None)
        except BitstreamError as err:
            if losses is None:
                raise
            record, damage = losses.pass_over(reader, number, err), err
        if record is None:
            return
        yield number, record, damage


def decode_live(
    config: CodecConfig,
    source: LiveSource,
    jobs: int = 1,
    stop: Readable | None = None,
    limits: Limits | None = None,
) -> Iterator[DecodedGroup]:
    """Decode what an encoder at the other end of a connection sends, asking for parity as it is needed.

    Parameters
    ----------
    config : CodecConfig
        The sequence's configuration, or that with the decoder's own choice of side information.
    source : LiveSource
        The encoder.
    jobs : int, optional
        Processes that decode groups at the same time, many in each.
    stop : Readable, optional
        Once it is readable, decoded groups are yielded, then `KeyboardInterrupt` is raised.
    limits : Limits, optional
        Most that may be spent; by default the memory of the program, and any number of frames.

    Yields
    ------
    DecodedGroup
        In display order.

    Raises
    ------
    BitstreamError, FeedbackError
        If the encoder sends data that cannot be decoded, or a lost connection is not replaced in time.
    """
    limits, tasks = limits or Limits(), _Tasks(config)
    limits.check_memory(config.video, max_open_gops(config) * config.gop.length, jobs)

    def _task(gop: Gop) -> GroupTask:
        task = tasks.add(gop.number, gop.record, None)
        limits.check_live_frames(task.last_index + 1)
        return task

    while True:
        groups = LiveGroups(source, _task, stop)
        try:
            yield from groups.timed(GroupsInFlight(groups, jobs).decode())
            return
        except ConnectionLostError as err:  # groups that are not written begin again
            if not source.reconnect(err):
                return


class StreamGroups:
    """Groups of a stream, as many at a time as the processes have room for."""

    def __init__(self, tasks: Iterable[GroupTask], jobs: int) -> None:
        self._tasks = iter(tasks)
        self._num_open, self._max_open = 0, GROUPS_PER_PROCESS * jobs
        self.finished = False

    def poll(self) -> Iterator[GroupTask | BitstreamError]:
        """Read as many groups as the processes have room for."""
        while not self.finished and self._num_open < self._max_open:
            try:
                task = next(self._tasks, None)
            except BitstreamError as err:
                self.finished = True
                yield err
                return
            self.finished = task is None
            if task is not None:
                self._num_open += 1
                yield task

    def wait(self, processes: Sequence[DecodingProcess]) -> list[DecodingProcess]:
        """Wait for processes, if any is at work."""
        busy: list[Any] = [process for process in processes if process.num_running]
        return cast(list[DecodingProcess], wait(busy)) if busy else []

    def request(self, requests: Sequence[ParityRequest], process: DecodingProcess) -> None:
        """Refuse requests: records answer them in the processes."""
        assert not requests, process

    def consumed(self) -> None:
        """Make room for another group."""
        self._num_open -= 1


class _Tasks:
    """Decodes the key frames, and knows which one is directly before a group."""

    def __init__(self, config: CodecConfig, next_index: int = 0) -> None:
        video = config.video
        self._config = config
        self._packed = encode_config(config)
        self._decoder = KeyFrameDecoder(
            video.width, video.height, luma_only=video.luma_only, parameter_sets=config.key.parameter_sets
        )
        self.next_index = next_index
        self._num_chained = 0  # frames since the last IDR picture
        self._last_s: Fraction | None = None  # when the last frame before is shown
        self._before: ReferenceFrame | None = None

    def skip(self, num_frames: int) -> None:
        """Go past frames that are lost or not wanted."""
        self.next_index += num_frames
        self._before = None

    def add(self, number: int, record: GopRecord, form: Form | None) -> GroupTask:
        """Decode the next key frame."""
        with naming_group(number, "key frame: "):
            self._num_chained = self._num_chained + record.num_frames if record.predicted else 1
            if self._num_chained > max(self._config.key.intra_period, 1):
                raise BitstreamError(f"no IDR picture since {self._num_chained} frames")
            key = self._decoder.decode(record.key, predicted=record.predicted)
        with naming_group(number):
            times_s = frame_times_s(self._config.video, self.next_index, record.num_frames, record.deviations)
            check_times(times_s, self._last_s)
        if record.num_frames == 1 and record.tracks:
            raise BitstreamError(f"group of pictures {number}: tracks, but no Wyner-Ziv frames")
        task = GroupTask(self._packed, number, self.next_index, self._before, key, record, form)
        self.next_index += record.num_frames
        self._before = ReferenceFrame(task.last_index, key)
        self._last_s = times_s[-1]
        return task


@dataclass
class _Asked:
    """Requests that a group has made together."""

    process: DecodingProcess
    number: int  # number of the group
    places: list[Place]
    answers: dict[Place, Bits] = field(default_factory=dict)


class GroupsInFlight:
    """Groups of pictures that are decoded at the same time; the same bytes for any number of processes."""

    def __init__(self, source: StreamGroups | LiveGroups, jobs: int, losses: Losses | None = None) -> None:
        self._source, self._jobs, self._losses = source, jobs, losses
        self._stack = ExitStack()
        self._processes: list[DecodingProcess] = []
        self._waiting: deque[GroupTask] = deque()  # groups of a stream, until a process is idle
        self._asked: dict[Place, _Asked] = {}
        self._order: deque[int] = deque()  # numbers of the groups in work
        self._tasks: dict[int, GroupTask] = {}  # their tasks, which remain if they are damaged
        self._outcomes: dict[int, DecodedGroup | Exception] = {}

    def decode(self) -> Iterator[DecodedGroup]:
        """Decode all groups of the source; raise errors after all groups before them."""
        failure: BaseException | None = None
        with self._stack:
            while failure is None and (self._order or not self._source.finished):
                try:
                    self._start_received()
                    if not self._is_ready():
                        for process in self._source.wait(self._processes):
                            self._receive(process)
                        self._start_received()
                except (Exception, KeyboardInterrupt) as err:
                    failure = err
                while self._is_ready():
                    number = self._order.popleft()
                    outcome, task = self._outcomes.pop(number), self._tasks.pop(number, None)
                    if isinstance(outcome, BitstreamError) and self._losses is not None and task is not None:
                        outcome = self._losses.rest_of(task, outcome)
                    if isinstance(outcome, Exception):
                        raise outcome
                    yield outcome
                    self._source.consumed()
        if failure is not None:
            raise failure

    def _is_ready(self) -> bool:
        return bool(self._order) and self._order[0] in self._outcomes

    def _start_received(self) -> None:
        """Pass new groups and answers to the processes."""
        answers: dict[DecodingProcess, list[Answered]] = {}
        for received in self._source.poll():
            if isinstance(received, ParityAnswer):
                place = received.frame, received.run
                asked = self._asked.pop(place)
                asked.answers[place] = received.bits
                if len(asked.answers) == len(asked.places):
                    bits = tuple(asked.answers[place] for place in asked.places)
                    answers.setdefault(asked.process, []).append(Answered(asked.number, bits))
            elif isinstance(received, BitstreamError):
                self._order.append(-1)
                self._outcomes[-1] = received
            else:
                self._order.append(received.number)
                if self._losses is not None:
                    self._tasks[received.number] = received
                if received.record.wyner_ziv:
                    self._waiting.append(received)
                else:
                    self._outcomes[received.number] = DecodedGroup.of(received, [])
        for process, messages in answers.items():
            process.submit(*messages)
        while self._waiting:
            num_busy = sum(process.num_running > 0 for process in self._processes)
            if self._waiting[0].form is not None and num_busy >= self._jobs:
                return
            if num_busy == len(self._processes) < self._jobs:
                self._processes.append(self._stack.enter_context(decoding_process()))
            idlest = min(self._processes, key=lambda process: (process.num_running, process.began_s))
            idlest.submit(self._waiting.popleft())

    def _receive(self, process: DecodingProcess) -> None:
        """Receive the requests or the result of a group from a process."""
        number, outcome = process.receive()
        if isinstance(outcome, DecodedGroup | Exception):
            self._outcomes[number] = outcome
        else:
            asked = _Asked(process, number, [(request.frame, request.run) for request in outcome])
            self._asked |= dict.fromkeys(asked.places, asked)
            self._source.request(outcome, process)
