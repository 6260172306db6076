"""Groups of pictures decoded in processes of their own, whose libraries do not depend on the processor.

What a decoder predicts decides what it asks for, so a punctured stream can only be decoded where the very
same predictions are made. Libraries choose their code by the processor when they load: the processes are
started with an environment that holds them to one baseline, whatever the program that imports this module
has loaded before.
"""

import atexit
import subprocess
import sys
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import Pipe

from decoder.tasks import DecodedGroup, GroupTask
from dvc.environment import baseline_environment
from dvc.errors import BitstreamError, DvcError
from dvc.turbo import Answer, ParityRequest


class DecodingProcess:
    """A process that decodes one group at a time; see `decoder.worker`."""

    def __init__(self) -> None:
        self.busy = False
        self._connection, other = Pipe()
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "decoder.worker", str(other.fileno())],
                env=baseline_environment(),
                pass_fds=[other.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )

    def decode(self, task: GroupTask, answer: Answer | None = None) -> DecodedGroup:
        """Decode a group.

        Parameters
        ----------
        task : GroupTask
            The group.
        answer : callable, optional
            Answers its requests, where it is not from a stream.

        Returns
        -------
        DecodedGroup
            Its frames.

        Raises
        ------
        BitstreamError
            If it is damaged.
        DvcError
            If the process dies.
        """
        self.busy = True
        try:
            self._connection.send(task)
            outcome = self._connection.recv()
            while answer is not None and isinstance(outcome, ParityRequest):
                self._connection.send(answer(outcome))
                outcome = self._connection.recv()
        except (EOFError, BrokenPipeError, ConnectionResetError) as err:
            raise DvcError("a decoding process was killed; is there enough memory for --jobs?") from err
        self.busy = False
        if isinstance(outcome, Exception):
            raise outcome
        assert isinstance(outcome, DecodedGroup)
        return outcome

    @property
    def alive(self) -> bool:
        """Whether it can decode."""
        return self._process.poll() is None

    def stop(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.wait()
        self._connection.close()


_idle: list[DecodingProcess] = []  # kept for the next sequence: they take about a second to start


@atexit.register
def _stop_idle() -> None:
    while _idle:
        _idle.pop().stop()


@contextmanager
def decoding_processes(count: int) -> Iterator[list[DecodingProcess]]:
    """Lend processes; those that come back busy are stopped, the others kept.

    Parameters
    ----------
    count : int
        How many.

    Yields
    ------
    list of DecodingProcess
        Ready to decode.
    """
    lent = [process for process in (_idle.pop() for _ in range(min(count, len(_idle)))) if process.alive]
    lent += [DecodingProcess() for _ in range(count - len(lent))]
    try:
        yield lent
    finally:
        for process in lent:
            if process.busy:
                process.stop()
            else:
                _idle.append(process)


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
    with ThreadPoolExecutor(jobs) as executor, decoding_processes(jobs) as processes:
        try:
            for outcome in _submitted(tasks, executor, deque(processes)):
                pending.append(outcome)
                while len(pending) > jobs + 1 or (pending and pending[0].done()):
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            executor.shutdown(wait=False, cancel_futures=True)


def _submitted(
    tasks: Iterable[GroupTask], executor: Executor, free: deque[DecodingProcess]
) -> Iterator[Future[DecodedGroup]]:
    """Start the groups; damage of the stream waits its turn like the outcome of a group."""

    def decode(task: GroupTask) -> DecodedGroup:
        process = free.popleft()  # there are as many as threads
        try:
            return process.decode(task)
        finally:
            free.append(process)

    try:
        for task in tasks:
            yield executor.submit(decode, task)
    except BitstreamError as err:
        damage: Future[DecodedGroup] = Future()
        damage.set_exception(err)
        yield damage
