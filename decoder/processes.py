"""Groups of pictures decoded in parallel, in processes with libraries that do not depend on the processor.

A stream and a live encoder are decoded alike: a source gives groups in order of display, processes decode
them, and their requests go to the source. Requests for frames of a stream never come here: the process finds
the answers in the record of the group.

Predictions determine requests, so that a punctured stream needs exactly the same predictions. Libraries
choose their code by the processor when they load. The environment of these processes therefore holds the
libraries to one baseline, independent of those that the parent has loaded.
"""

import atexit
import os
import signal
import subprocess
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import RLock
from typing import Any, Protocol

from decoder.group_tasks import Answered, Bits, DecodedGroup, GroupTask, Losses
from dvc.environment import COMPILATION_NOTICE, ONE_HEAP, baseline_environment, python_module
from dvc.errors import BitstreamError, DvcError
from dvc.feedback import ParityAnswer
from dvc.slepian_wolf import ParityRequest, Place, Round

Outcome = Round | DecodedGroup | Exception
_MAX_IDLE = 2  # processes kept for the next sequence: they take about a second to start, and some memory


class DecodingProcess:
    """A process that decodes groups; see `decoder.worker`."""

    def __init__(self) -> None:
        self.num_running = self.num_pending = self._num_sent = 0
        self.step_s = self.began_s = 0.0
        self._connection, other = Pipe()
        with other:
            self._process = self._start(other)

    def _start(self, connection: "Connection[Any, Any]") -> Any:
        """Start the process with its end of the pipe; return it as `Popen` does."""
        command = python_module("decoder.worker", connection.fileno())
        # Whoever starts the process ends it; an interrupt from the terminal is not for it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            return subprocess.Popen(
                command,
                env=baseline_environment() | ONE_HEAP,
                pass_fds=[connection.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        finally:
            os.environ[COMPILATION_NOTICE] = ""  # the first process prints it
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def submit(self, *messages: GroupTask | Answered) -> None:
        """Start groups, or continue with open ones."""
        tasks = [message for message in messages if isinstance(message, GroupTask)]
        self.num_running += len(tasks)
        if not self.num_pending:
            self.began_s = time.monotonic()
        self._num_sent += len(messages)
        self.num_pending += len(messages)
        try:
            self._connection.send(messages)  # at once: each wakes the process
        except OSError as err:
            raise self._death() from err

    def receive(self) -> tuple[int, Outcome]:
        """Wait for requests or the result of a group."""
        try:
            number, outcome, num_ready, num_taken = self._connection.recv()
        except (EOFError, OSError) as err:
            raise self._death() from err
        self.num_running -= isinstance(outcome, DecodedGroup | Exception)
        self.num_pending = num_ready + self._num_sent - num_taken
        now_s = time.monotonic()
        self.step_s, self.began_s = now_s - self.began_s, now_s
        return number, outcome

    def fileno(self) -> int:
        """Return the file descriptor that can be read when something is to be received."""
        return self._connection.fileno()

    def _death(self) -> DvcError:
        try:  # a process that ends by itself has an exit status
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
        """Kill the process."""
        self._process.kill()

    def stop(self) -> None:
        """Kill the process, and release it."""
        self.kill()
        self._process.wait()
        self._connection.close()
        _started.discard(self)


# All that are not stopped: where whoever was lent one is collected as garbage, the process comes back, and
# must not be collected with it, which closes its connection.
_started: set[DecodingProcess] = set()
_idle: list[DecodingProcess] = []
_lock = RLock()  # a collection may happen anywhere


@atexit.register
def stop_idle_processes() -> None:
    """Keep no process for a next sequence, which gets new ones."""
    while _idle:
        _idle.pop().stop()


@contextmanager
def decoding_process() -> Iterator[DecodingProcess]:
    """Lend a process; a busy one is stopped on return, idle ones are kept for the next loan."""
    with _lock:
        process = _idle.pop() if _idle else None
    if process is not None and not process.alive:
        process.stop()
        process = None
    process = process or DecodingProcess()
    _started.add(process)
    try:
        yield process
    finally:
        with _lock:
            kept = process.num_running == 0 and process.alive and len(_idle) < _MAX_IDLE
            if kept:
                _idle.append(process)
        if not kept:
            process.stop()


class GroupSource(Protocol):
    """Provides groups to decode, and receives their requests."""

    @property
    def finished(self) -> bool:
        """Whether all groups have been received."""

    def poll(self) -> Iterable[GroupTask | ParityAnswer | BitstreamError]:
        """Return new groups and answers without waiting; nothing follows damage."""

    def wait(self, processes: Sequence[DecodingProcess]) -> Iterable[DecodingProcess]:
        """Wait until something comes from a process or to the source; return the processes."""

    def request(self, requests: Sequence[ParityRequest], process: DecodingProcess) -> None:
        """Take requests of a process."""

    def consumed(self) -> None:
        """Record that the next group has been consumed, which makes room for another."""


@dataclass
class _Asked:
    """Requests that a group has made together."""

    process: DecodingProcess
    number: int  # number of the group
    places: list[Place]
    answers: dict[Place, Bits] = field(default_factory=dict)


class GroupsInFlight:
    """Groups of pictures that are decoded at the same time; the same bytes for any number of processes."""

    def __init__(self, source: GroupSource, jobs: int, losses: Losses | None = None) -> None:
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
                            self._dispatch(process)
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
                continue
            if isinstance(received, BitstreamError):
                self._order.append(-1)
                self._outcomes[-1] = received
                continue
            self._order.append(received.number)
            if self._losses is not None:
                self._tasks[received.number] = received
            if received.record.wyner_ziv:
                self._waiting.append(received)
            else:
                self._outcomes[received.number] = DecodedGroup.of(received, [])
        for process, own in answers.items():
            process.submit(*own)
        while self._waiting and (self._waiting[0].form is None or self._is_one_idle()):
            self._begin(self._waiting.popleft())

    def _is_one_idle(self) -> bool:
        num_busy = sum(process.num_running > 0 for process in self._processes)
        return num_busy < self._jobs

    def _begin(self, task: GroupTask) -> None:
        """Hand on a group to the process that has least to do, or to a new one."""
        idle = [process for process in self._processes if not process.num_running]
        if not idle and len(self._processes) < self._jobs:
            self._processes.append(self._stack.enter_context(decoding_process()))
        process = min(self._processes, key=lambda process: (process.num_running, process.began_s))
        process.submit(task)

    def _dispatch(self, process: DecodingProcess) -> None:
        """Receive the requests or the result of a group from a process."""
        number, outcome = process.receive()
        if isinstance(outcome, DecodedGroup | Exception):
            self._outcomes[number] = outcome
        else:
            asked = _Asked(process, number, [(request.frame, request.run) for request in outcome])
            self._asked |= dict.fromkeys(asked.places, asked)
            self._source.request(outcome, process)
