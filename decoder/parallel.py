"""Groups of pictures decoded in processes of their own, whose libraries do not depend on the processor.

What a decoder predicts decides what it asks for, so a punctured stream can only be decoded where the very
same predictions are made. Libraries choose their code by the processor when they load: the processes are
started with an environment that holds them to one baseline, whatever the program that imports this module
has loaded before.
"""

import atexit
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import Pipe
from threading import Event, Lock

from decoder.tasks import Answered, DecodedGroup, GroupTask, following
from dvc.environment import baseline_environment
from dvc.errors import BitstreamError, DvcError
from dvc.slepian_wolf import ParityRequest

Outcome = Sequence[ParityRequest] | DecodedGroup | Exception
_MAX_IDLE = 2  # processes kept for the next sequence: they take about a second to start, and some memory


class DecodingProcess:
    """A process that decodes groups; see `decoder.worker`."""

    def __init__(self) -> None:
        self.num_running = self.num_pending = 0
        self.step_s = self._began_s = 0.0
        self._connection, other = Pipe()
        command = [sys.executable, "-P", "-m", "decoder.worker", str(other.fileno())]
        # Whoever starts the process ends it; an interrupt from the terminal is not for it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            with other:
                self._process = subprocess.Popen(
                    command,
                    env=baseline_environment(),
                    pass_fds=[other.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def decode(self, task: GroupTask) -> DecodedGroup:
        """Decode a group of a stream."""
        self.submit(task)
        _, outcome = self.receive()
        if isinstance(outcome, Exception):
            raise outcome
        assert isinstance(outcome, DecodedGroup)
        return outcome

    def submit(self, message: GroupTask | Answered) -> None:
        """Begin a group, besides those that are under way, or go on with one."""
        self.num_running += isinstance(message, GroupTask)
        if not self.num_pending:
            self._began_s = time.monotonic()
        self.num_pending += 1
        try:
            self._connection.send(message)
        except OSError as err:
            raise self._death() from err

    def receive(self) -> tuple[int, Outcome]:
        """Wait for what a group asks for, or comes to."""
        try:
            number, outcome, answers = self._connection.recv()
        except (EOFError, OSError) as err:
            raise self._death() from err
        self.num_running -= isinstance(outcome, DecodedGroup | Exception)
        self.num_pending -= answers  # not a level that was begun by itself
        now_s = time.monotonic()
        self.step_s, self._began_s = now_s - self._began_s, now_s
        return number, outcome

    def fileno(self) -> int:
        """Return the file descriptor that can be read when something is to be received."""
        return self._connection.fileno()

    def _death(self) -> DvcError:
        try:  # a process that ends by itself says how
            status = self._process.wait(timeout=1)
        except subprocess.TimeoutExpired:
            self.kill()
            status = self._process.wait()
        how = (
            "was killed; is there enough memory for --jobs?" if status < 0 else f"ended with status {status}"
        )
        return DvcError(f"a decoding process {how}")

    @property
    def alive(self) -> bool:
        """Whether it can decode."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Make it end, whatever it does."""
        self._process.kill()

    def stop(self) -> None:
        """End it, and let go of it."""
        self.kill()
        self._process.wait()
        self._connection.close()


_idle: list[DecodingProcess] = []
_lock = Lock()


@atexit.register
def stop_idle_processes() -> None:
    """Keep no process for a next sequence, which gets new ones."""
    while _idle:
        _idle.pop().stop()


@contextmanager
def decoding_process() -> Iterator[DecodingProcess]:
    """Lend a process; one that comes back at work is stopped, others are kept for the next."""
    with _lock:
        process = _idle.pop() if _idle else None
    if process is not None and not process.alive:
        process.stop()
        process = None
    process = process or DecodingProcess()
    try:
        yield process
    finally:
        with _lock:
            kept = process.num_running == 0 and process.alive and len(_idle) < _MAX_IDLE
            if kept:
                _idle.append(process)
        if not kept:
            process.stop()


Chain = Sequence[GroupTask]
"""Consecutive groups, each but the first predicted from the one before it."""
_Outcomes = deque[Future[DecodedGroup]]


def decode_groups(chains: Iterable[Chain], jobs: int) -> Iterator[DecodedGroup]:
    """Decode groups of pictures; the same bytes for any number of jobs."""
    pending: deque[_Outcomes] = deque()
    decoding = _Decoding()
    with ThreadPoolExecutor(jobs) as executor:
        try:
            for outcomes in _submitted(chains, executor, decoding):
                pending.append(outcomes)
                while pending and (len(pending) > jobs + 1 or pending[0][0].done()):
                    yield _next(pending)
            while pending:
                yield _next(pending)
        finally:
            decoding.give_up()
            executor.shutdown(wait=False, cancel_futures=True)
            decoding.kill()


def _next(pending: deque[_Outcomes]) -> DecodedGroup:
    group = pending[0].popleft().result()
    if not pending[0]:
        pending.popleft()
    return group


class _Decoding:
    """Decodes chains in processes until it is given up."""

    def __init__(self) -> None:
        self._lent: set[DecodingProcess] = set()
        self._closed = Event()

    def give_up(self) -> None:
        self._closed.set()

    def kill(self) -> None:
        for process in tuple(self._lent):
            process.kill()

    def run(self, chain: Chain, outcomes: Sequence[Future[DecodedGroup]]) -> None:
        """Decode one group after the other; the first that fails is the last."""
        if not any(task.record.wyner_ziv for task in chain):
            for task, outcome in zip(chain, outcomes, strict=True):
                outcome.set_result(DecodedGroup.of(task, []))
            return
        remaining = iter(outcomes)
        outcome = next(remaining)
        try:
            with decoding_process() as process:
                self._lent.add(process)
                try:
                    for group in self._groups(chain, process):
                        outcome.set_result(group)
                        outcome = next(remaining, outcome)
                finally:
                    self._lent.discard(process)
        except Exception as err:
            outcome.set_exception(err)

    def _groups(self, chain: Chain, process: DecodingProcess) -> Iterator[DecodedGroup]:
        group = None
        for task in chain:
            if self._closed.is_set():
                raise DvcError("decoding was given up")
            group = process.decode(following(task, group))
            yield group


def _submitted(chains: Iterable[Chain], executor: Executor, decoding: _Decoding) -> Iterator[_Outcomes]:
    """Start the chains; damage of the stream waits its turn like the outcome of a group."""
    try:
        for chain in chains:
            outcomes = [Future[DecodedGroup]() for _ in chain]
            executor.submit(decoding.run, chain, outcomes)
            yield deque(outcomes)
    except BitstreamError as err:
        damage: Future[DecodedGroup] = Future()
        damage.set_exception(err)
        yield deque([damage])
