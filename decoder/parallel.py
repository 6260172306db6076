"""Groups of pictures decoded in processes of their own: plain data goes there and comes back, in order."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context

from decoder.group import DecodedGroup, GroupDecoder, naming_group
from decoder.side_information.protocol import ReferenceFrame
from decoder.wyner_ziv import DecodedFrame
from dvc.config import decode_config
from dvc.errors import BitstreamError, DvcError
from dvc.stream import Form, GopRecord
from dvc.video import Frame


@dataclass(frozen=True)
class GroupTask:
    """A group of pictures whose Wyner-Ziv frames may be decoded anywhere.

    Attributes
    ----------
    config : bytes
        Configuration of the stream, as `dvc.config.encode_config` packs it.
    number : int
        Number of the group, from 0.
    first_index : int
        Display position of its first frame.
    references : tuple of two ReferenceFrame, optional
        The key frames around it; none where it has no Wyner-Ziv frames.
    key : Frame
        The key frame that ends it.
    record : GopRecord
        What the stream holds of it.
    form : Form
        Form of the stream: buffered or punctured.
    """

    config: bytes
    number: int
    first_index: int
    references: tuple[ReferenceFrame, ReferenceFrame] | None
    key: Frame
    record: GopRecord
    form: Form


def decode_groups(tasks: Iterable[GroupTask], jobs: int) -> Iterator[DecodedGroup]:
    """Decode groups of pictures; the same bytes for any number of jobs.

    Parameters
    ----------
    tasks : iterable of GroupTask
        The groups, in display order.
    jobs : int
        Processes that decode groups at the same time.

    Yields
    ------
    DecodedGroup
        In the order of the tasks; at most ``jobs + 2`` are held.

    Raises
    ------
    BitstreamError
        If the stream is damaged; all groups before the damage are yielded first.
    """
    pending: deque[Future[DecodedGroup]] = deque()
    with _executor(jobs) as executor:
        try:
            for outcome in _submitted(tasks, executor):
                pending.append(outcome)
                while len(pending) > jobs + 1 or (pending and pending[0].done()):
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool as err:
            raise DvcError("a decoding process was killed; is there enough memory for --jobs?") from err
        finally:
            executor.shutdown(cancel_futures=True)


def _submitted(tasks: Iterable[GroupTask], executor: Executor) -> Iterator[Future[DecodedGroup]]:
    """Start the groups; damage of the stream waits its turn like the outcome of a group."""
    try:
        for task in tasks:
            yield executor.submit(_decode, task)
    except BitstreamError as err:
        damage: Future[DecodedGroup] = Future()
        damage.set_exception(err)
        yield damage


def _executor(jobs: int) -> Executor:
    if jobs == 1:
        return _InlineExecutor()
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))


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


def _decode(task: GroupTask) -> DecodedGroup:
    frames: list[DecodedFrame] = []
    if task.references is not None:
        with naming_group(task.number):
            frames = _decoder(task.config).decode(task.references, task.record, task.form)
    return DecodedGroup.of(task.first_index, frames, task.key, task.record)


_decoders: dict[bytes, GroupDecoder] = {}


def _decoder(config: bytes) -> GroupDecoder:
    """Decoder of a configuration, kept by the process for the next group."""
    if config not in _decoders:
        _decoders.clear()
        _decoders[config] = GroupDecoder(decode_config(config))
    return _decoders[config]
