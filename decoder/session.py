"""The decoder of figure 5.1: stream or connection in; decoded groups of pictures, and what they cost, out."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context

from decoder.group import DecodedWynerZiv, GroupDecoder
from decoder.live import LiveSource
from decoder.side_information.protocol import ReferenceFrame
from dvc.config import CodecConfig, decode_config, encode_config
from dvc.errors import BitstreamError, DvcError
from dvc.keyframes import KeyFrameDecoder
from dvc.stream import GopRecord, StreamReader
from dvc.video import Frame


@dataclass(frozen=True)
class DecodedGroup:
    """One decoded group of pictures.

    Attributes
    ----------
    first_index : int
        Display position of its first frame.
    wyner_ziv : tuple of DecodedWynerZiv
        Its Wyner-Ziv frames, in display order.
    key : Frame
        The key frame that ends it.
    record : GopRecord
        The record of the punctured form: what was really needed.
    """

    first_index: int
    wyner_ziv: tuple[DecodedWynerZiv, ...]
    key: Frame
    record: GopRecord


@dataclass(frozen=True)
class _Task:
    """A group whose Wyner-Ziv frames may be decoded anywhere; pickled on its way to another process."""

    config: bytes
    number: int
    keys: tuple[ReferenceFrame, ReferenceFrame] | None
    record: GopRecord
    key: Frame
    first_index: int
    form: str


def decode_stream(config: CodecConfig, reader: StreamReader, jobs: int = 1) -> Iterator[DecodedGroup]:
    """Decode a stream group by group; the same bytes for any number of jobs.

    Parameters
    ----------
    config : CodecConfig
        The stream's configuration, or that with the decoder's own choice of side information.
    reader : StreamReader
        The stream, buffered or punctured.
    jobs : int, optional
        Processes that decode groups at the same time.

    Yields
    ------
    DecodedGroup
        In display order; at most ``jobs + 2`` are held.

    Raises
    ------
    BitstreamError
        If the stream is damaged; all groups before the damage are yielded first.
    """
    tasks = _tasks(config, reader)
    pending: deque[Future[DecodedGroup]] = deque()
    failure: BitstreamError | None = None
    with _executor(jobs) as executor:
        try:
            while True:
                try:
                    task = next(tasks, None)
                except BitstreamError as err:
                    task, failure = None, err
                if task is None:
                    break
                pending.append(executor.submit(_decode_task, task))
                while len(pending) > jobs + 1 or (pending and pending[0].done()):
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool as err:
            raise DvcError("a decoding process was killed; is there enough memory for --jobs?") from err
        finally:
            executor.shutdown(cancel_futures=True)
    if failure is not None:
        raise failure


def decode_live(config: CodecConfig, source: LiveSource) -> Iterator[DecodedGroup]:
    """Decode what an encoder at the other end of a connection sends, asking for parity as it is needed.

    Parameters
    ----------
    config : CodecConfig
        The sequence's configuration, or that with the decoder's own choice of side information.
    source : LiveSource
        The encoder.

    Yields
    ------
    DecodedGroup
        In display order.

    Raises
    ------
    BitstreamError, FeedbackError
        If the encoder sends what cannot be decoded.
    """
    keys = _KeyFrames(config)
    decoder = GroupDecoder(config)
    for gop in source.groups():
        first_index, around, key = keys.add(gop.number, gop.record)
        frames: list[DecodedWynerZiv] = []
        if around is not None:
            with _named(gop.number):
                frames = decoder.decode_live(around, gop.record, source.answer)
        yield _finished(first_index, frames, key, gop.record)


class _KeyFrames:
    """Decodes the key frames, and knows between which two a group lies."""

    def __init__(self, config: CodecConfig) -> None:
        video = config.video
        self._decoder = KeyFrameDecoder(
            video.width, video.height, luma_only=video.luma_only, parameter_sets=config.key.parameter_sets
        )
        self._previous: ReferenceFrame | None = None

    def add(
        self, number: int, record: GopRecord
    ) -> tuple[int, tuple[ReferenceFrame, ReferenceFrame] | None, Frame]:
        """Decode the next group's key frame; return first index, references (None: not needed), key frame."""
        with _named(number, "key frame: "):
            key = self._decoder.decode(record.key)
        first_index = 0 if self._previous is None else self._previous.index + 1
        current = ReferenceFrame(first_index + record.num_frames - 1, key)
        around = None if self._previous is None else (self._previous, current)
        if record.num_frames > 1 and around is None:
            raise BitstreamError(f"group of pictures {number}: Wyner-Ziv frames before the first key frame")
        if record.num_frames == 1 and record.tracks:
            raise BitstreamError(f"group of pictures {number}: tracks, but no Wyner-Ziv frames")
        self._previous = current
        return first_index, around if record.num_frames > 1 else None, key


@contextmanager
def _named(number: int, part: str = "") -> Iterator[None]:
    """Say of damage in which group of pictures it is."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"group of pictures {number}: {part}{err}") from err


def _tasks(config: CodecConfig, reader: StreamReader) -> Iterator[_Task]:
    keys = _KeyFrames(config)
    packed = encode_config(config)
    for number, record in enumerate(reader):
        first_index, around, key = keys.add(number, record)
        yield _Task(packed, number, around, record, key, first_index, reader.form)


def _decode_task(task: _Task) -> DecodedGroup:
    frames: list[DecodedWynerZiv] = []
    if task.keys is not None:
        with _named(task.number):
            frames = _group_decoder(task.config).decode_payloads(task.keys, task.record, task.form)
    return _finished(task.first_index, frames, task.key, task.record)


def _finished(first_index: int, frames: list[DecodedWynerZiv], key: Frame, record: GopRecord) -> DecodedGroup:
    needed = tuple(frame.punctured for frame in frames)
    return DecodedGroup(
        first_index, tuple(frames), key, GopRecord(record.num_frames, record.key, record.tracks, needed)
    )


_decoders: dict[bytes, GroupDecoder] = {}


def _group_decoder(config: bytes) -> GroupDecoder:
    """Decoder of a configuration, kept by the process for the next group."""
    if config not in _decoders:
        _decoders.clear()
        _decoders[config] = GroupDecoder(decode_config(config))
    return _decoders[config]


class _InlineExecutor(Executor):
    """Runs each task at once in this process."""

    def submit(self, function, /, *args, **kwargs):  # type: ignore[no-untyped-def]
        """Run a task; its outcome waits in the future like that of any executor."""
        future: Future[object] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except DvcError as err:
            future.set_exception(err)
        return future


def _executor(jobs: int) -> Executor:
    if jobs == 1:
        return _InlineExecutor()
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
