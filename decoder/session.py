"""The decoder of figure 5.1: stream or connection in; decoded groups of pictures, and what they cost, out."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from multiprocessing.connection import wait
from typing import Any, cast

from decoder.live import LiveGroups, LiveSource
from decoder.processes import DecodingProcess, GroupsInFlight
from decoder.side_information.protocol import ReferenceFrame
from decoder.tasks import DecodedGroup, GroupTask, naming_group
from dvc.config import MAX_LONG_TERM_KEY_BYTES, CodecConfig, encode_config
from dvc.errors import BitstreamError
from dvc.feedback import Gop, max_open_gops
from dvc.feedback.link import Readable
from dvc.keyframes import KeyFrameDecoder
from dvc.limits import Limits
from dvc.slepian_wolf import ParityRequest
from dvc.stream import Form, GopRecord, RecordingReader, StreamReader, check_times, frame_times_s

Reader = StreamReader | RecordingReader
CHAINS_PER_PROCESS = 2
"""One that a process is at, and one that it goes on with while whoever takes the frames is busy."""


def decode_stream(
    config: CodecConfig,
    reader: Reader,
    jobs: int = 1,
    frames: range | None = None,
    limits: Limits | None = None,
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

    Returns
    -------
    iterator of DecodedGroup
        In display order; it raises `BitstreamError` where the stream is damaged, after all groups before.
    """
    limits = limits or Limits()
    check_stream(config, reader, jobs, frames, limits)
    chains = stream_tasks(config, reader, frames, limits)
    return GroupsInFlight(StreamGroups(chains, jobs), jobs).decode()


def check_stream(
    config: CodecConfig, reader: Reader, jobs: int, frames: range | None, limits: Limits
) -> None:
    """Refuse a stream of too many frames, or with too large ones for so many processes."""
    num_frames = reader.num_frames if frames is None else len(frames)
    limits.check_frames(num_frames, reader.num_bytes, config.video)
    gop = config.gop
    num_waiting = (CHAINS_PER_PROCESS * jobs + 1) * gop.length + (jobs - 1) * gop.intra_period
    limits.check_memory(config.video, min(num_waiting, num_frames) if num_frames else num_waiting, jobs)


def stream_tasks(
    config: CodecConfig, reader: Reader, frames: range | None = None, limits: Limits | None = None
) -> Iterator[list[GroupTask]]:
    """Read a stream, and decode its key frames."""
    limits = limits or Limits()
    first_group = 0 if frames is None else _first_group(config, reader, frames.start)
    tasks = _Tasks(config) if frames is None else _tasks_from(config, reader, first_group)
    first_index, chain = tasks.next_index, list[GroupTask]()
    try:
        for number, record in enumerate(reader, first_group):
            task = tasks.add(number, record, reader.form)
            limits.check_frames(task.last_index + 1 - first_index, reader.num_bytes, config.video)
            if number > 0 and not chain and task.before is None:
                continue  # what it is predicted from is before the first group that was read
            chain.append(task)
            ended = frames is not None and task.last_index + 1 >= frames.stop
            if task.key is not None or ended:
                if frames is None or task.last_index >= frames.start:
                    yield chain
                chain = []
            if ended:
                return
    except BitstreamError:
        if chain:
            yield chain
        raise
    if chain:
        yield chain


def _first_group(config: CodecConfig, reader: Reader, frame: int) -> int:
    """Return the number of the group with which to start, to decode a frame."""
    back = config.gop.intra_period + config.gop.length if config.gop.intra_period else 0
    return max(reader.index.gop_of(max(frame - back, 0)) - 1, 0)  # for its key frame


def _tasks_from(config: CodecConfig, reader: Reader, group: int) -> "_Tasks":
    """Go on reading with a group; keep the key frames before it that it may name."""
    first = max(group - config.gop.long_term_window, 0)
    tasks = _Tasks(config, reader.index.first_frame(first))
    reader.seek_gop(first)
    with suppress(BitstreamError):  # damage there is that of a group that is not wanted
        for number, record in zip(range(first, group), reader, strict=False):
            tasks.pass_over(number, record)
    tasks.next_index = reader.index.first_frame(group)
    reader.seek_gop(group)
    return tasks


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
        Once it can be read, what is decoded already is yielded, then `KeyboardInterrupt` raised.
    limits : Limits, optional
        Most that may be spent; by default the memory of the program, and any number of frames.

    Yields
    ------
    DecodedGroup
        In display order.

    Raises
    ------
    BitstreamError, FeedbackError
        If the encoder sends what cannot be decoded.
    """
    limits, tasks = limits or Limits(), _Tasks(config)
    limits.check_memory(config.video, max_open_gops(config) * config.gop.length, jobs)

    def _task(gop: Gop) -> GroupTask:
        task = tasks.add(gop.number, gop.record, None)
        limits.check_live_frames(task.last_index + 1)
        return task

    groups = LiveGroups(source, _task, stop)
    yield from groups.timed(GroupsInFlight(groups, jobs).decode())
    source.flush()


class StreamGroups:
    """The groups of a stream, given chain by chain: consecutive ones, each predicted from that before it."""

    def __init__(self, chains: Iterable[Sequence[GroupTask]], jobs: int) -> None:
        self._chains = iter(chains)
        self._max_open = CHAINS_PER_PROCESS * jobs
        self._open: deque[int] = deque()  # groups of open chains that have not been taken
        self.finished = False

    def received(self) -> Iterator[GroupTask | BitstreamError]:
        """Read as many chains as there is room for."""
        while not self.finished and len(self._open) < self._max_open:
            try:
                chain = next(self._chains, ())
            except BitstreamError as err:
                self.finished = True
                yield err
                return
            self.finished = not chain
            if chain:
                self._open.append(len(chain))
                yield from chain

    def wait(self, processes: Sequence[DecodingProcess]) -> list[DecodingProcess]:
        """Wait for processes, where any is at work."""
        busy: list[Any] = [process for process in processes if process.num_running]
        return cast(list[DecodingProcess], wait(busy)) if busy else []

    def ask(self, requests: Sequence[ParityRequest], process: DecodingProcess) -> None:
        """Refuse requests, of which none come: records answer them."""
        assert not requests, process

    def taken(self) -> None:
        """Make room once the last group of a chain is taken."""
        if self._open:
            self._open[0] -= 1
            if not self._open[0]:
                self._open.popleft()


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
        self._num_without_key = 0
        self._last_s: Fraction | None = None  # when the last frame before is shown
        self._before: ReferenceFrame | None = None
        # Key frames of the latest groups, by group: display position, and as what it came.
        self._keys: dict[int, tuple[int, bytes]] = {}

    def add(self, number: int, record: GopRecord, form: Form | None) -> GroupTask:
        """Decode the next key frame, where there is one; a task lacks a frame before it that is none."""
        key = None
        self._num_without_key = self._num_without_key + record.num_frames if record.without_key else 0
        with naming_group(number, "key frame: "):
            if self._num_without_key > self._config.gop.intra_period:
                raise BitstreamError(f"none since {self._num_without_key} frames")
            if not record.without_key:
                key = self._decoder.decode(record.key)
        with naming_group(number):
            times_s = frame_times_s(self._config.video, self.next_index, record.num_frames, record.deviations)
            check_times(times_s, self._last_s)
        if record.num_frames == 1 and record.tracks and key is not None:
            raise BitstreamError(f"group of pictures {number}: tracks, but no Wyner-Ziv frames")
        long_term = self._long_term(number, record)
        task = GroupTask(self._packed, number, self.next_index, self._before, key, record, form, long_term)
        self.pass_over(number, record)
        self._before = None if key is None else ReferenceFrame(task.last_index, key)
        self._last_s = times_s[-1]
        return task

    def pass_over(self, number: int, record: GopRecord) -> None:
        """Go past a group, whose key frame is kept while later ones may name it."""
        self.next_index += record.num_frames
        window = self._config.gop.long_term_window
        self._keys.pop(number - window, None)
        if window and 0 < len(record.key) <= MAX_LONG_TERM_KEY_BYTES:
            self._keys[number] = self.next_index - 1, record.key

    def _long_term(self, number: int, record: GopRecord) -> ReferenceFrame | None:
        """Decode the earlier key frame that a group names."""
        if record.long_term is None:
            return None
        groups_back = record.long_term.groups_back
        with naming_group(number, "long-term reference: "):
            if number - groups_back not in self._keys:
                raise BitstreamError(f"no key frame that may be one {groups_back} groups back")
            index, key = self._keys[number - groups_back]
            return ReferenceFrame(index, self._decoder.decode(key))
