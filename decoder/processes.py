"""Processes that decode groups of pictures, with libraries that do not depend on the processor.

Predictions determine requests, so that a punctured stream needs exactly the same predictions. Libraries
choose their code by the processor when they load. The environment of these processes holds them to one
baseline.

Tasks, and answers of a live encoder, arrive through a connection; its file descriptor is the only argument
of this module as a program. Replies carry the number of their group: requests, and finally the decoded group
or an exception. Groups of a live encoder are coroutines: while some wait for answers, the rest continue,
first those with the most levels to follow. Memory bounds the number of levels that are decoded at the same
time.
"""

import atexit
import heapq
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import RLock
from typing import TYPE_CHECKING, Any

from decoder.group_tasks import Answered, Bits, DecodedGroup, GroupTask, naming_group
from dvc.config import decode_config
from dvc.environment import COMPILATION_NOTICE, ONE_HEAP, baseline_environment, python_module
from dvc.errors import DvcError
from dvc.slepian_wolf import Round

if TYPE_CHECKING:  # loads OpenCV
    from decoder.group import GroupCoroutine, GroupDecoder, Rank
    from decoder.wyner_ziv import WynerZivDecoder

Outcome = Round | DecodedGroup | Exception
MAX_ACTIVE_PX = 3 << 20
"""Pixels of frames of live groups that are decoded at a time, if that leaves one level of one group."""
_MAX_IDLE = 2  # processes kept for the next sequence: they take about a second to start, and some memory


class DecodingProcess:
    """A process that decodes groups."""

    def __init__(self) -> None:
        self.num_running = self.num_pending = self._num_sent = 0
        self.step_s = self.began_s = 0.0
        self._connection, other = Pipe()
        # The parent ends the process; an interrupt from the terminal is not for it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            with other:
                self._process = self._start(other)
        finally:
            os.environ[COMPILATION_NOTICE] = ""  # the first process prints it
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def _start(self, connection: "Connection[Any, Any]") -> "subprocess.Popen[bytes]":
        """Start a program; `benchmarks.hostile` forks a loaded process instead."""
        return subprocess.Popen(
            python_module("decoder.processes", connection.fileno()),
            env=baseline_environment() | ONE_HEAP,
            pass_fds=[connection.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )

    def submit(self, *messages: GroupTask | Answered) -> None:
        """Start groups, or continue with open ones."""
        self.num_running += sum(isinstance(message, GroupTask) for message in messages)
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


# All that are not stopped: if the user of a process is collected as garbage, the process comes back, and must
# not be collected with it, which closes its connection.
_started: set[DecodingProcess] = set()
_idle: list[DecodingProcess] = []
_lock = RLock()  # a collection may happen anywhere


@atexit.register
def stop_idle_processes() -> None:
    """Stop the processes that are kept for the next sequence."""
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
            is_kept = process.num_running == 0 and process.alive and len(_idle) < _MAX_IDLE
            if is_kept:
                _idle.append(process)
        if not is_kept:
            process.stop()


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until the connection closes."""
    stderr = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:  # OpenCV reports features that it must not use, and that the processor does not have
        import cv2  # noqa: F401
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
    worker = _Worker(connection)
    while True:
        try:
            worker.receive(wait=worker.is_idle)
            worker.step()
        except (EOFError, OSError):  # the parent has closed the connection
            os._exit(0)


@dataclass(eq=False)
class _LiveGroup:
    """A group with a coroutine that waits for its turn, for memory or for answers."""

    number: int
    config: bytes
    decoder: "GroupDecoder"
    steps: "GroupCoroutine"
    rank: "Rank"
    num_px: int = 0  # pixels of the level that is being decoded


class _Worker:
    """Groups that are under way, in one thread."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._num_taken = 0  # messages
        self._order = count()
        self._tasks: list[GroupTask] = []  # groups that have not begun
        self._groups: dict[int, _LiveGroup] = {}
        self._ready: list[tuple[Rank, int, int, Sequence[Bits] | None]] = []  # numbers, with bits to send
        self._paused: list[tuple[Rank, int, int]] = []  # for lack of memory
        self._used_px = 0
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []  # decoders for further groups of this configuration

    @property
    def is_idle(self) -> bool:
        """Whether the process has nothing to do before the next message."""
        return not (self._ready or self._tasks)

    def receive(self, wait: bool) -> None:
        """Receive messages."""
        while wait or self._connection.poll():
            for message in self._connection.recv():
                self._num_taken += 1
                if isinstance(message, Answered):
                    self._enqueue(self._groups[message.number], message.bits)
                else:
                    self._tasks.append(message)
            wait = False

    def _enqueue(self, group: _LiveGroup, sent: Sequence[Bits] | None) -> None:
        heapq.heappush(self._ready, (group.rank, next(self._order), group.number, sent))

    def step(self) -> None:
        """Decode a group of a stream, begin one of an encoder, or advance that of the first rank."""
        if self._tasks:
            task = self._tasks.pop(0)
            try:
                with naming_group(task.number):
                    decoder = self._acquire(task.config)
                    if task.form is None:
                        steps = decoder.steps(task)
                        group = _LiveGroup(task.number, task.config, decoder, steps, (0, task.number))
                        self._groups[task.number] = group
                        self._enqueue(group, None)
                        return
                    outcome: object = decoder.decode(task)
                    self._release(decoder, task.config)
            except Exception as err:
                outcome = _portable(err)
            self._send(task.number, outcome)
        elif self._ready:
            _, _, number, sent = heapq.heappop(self._ready)
            self._advance(self._groups[number], sent)

    def _advance(self, group: _LiveGroup, sent: Sequence[Bits] | None) -> None:
        """Advance a group to its next request, to the start of a level or to its end."""
        from decoder.group import LevelBegins

        outcome: object
        try:
            with naming_group(group.number):
                outcome = next(group.steps) if sent is None else group.steps.send(sent)
        except StopIteration as stop:
            self._release(group.decoder, group.config)
            outcome = stop.value
            del self._groups[group.number]
        except Exception as err:
            outcome = _portable(err)
            del self._groups[group.number]
        if isinstance(outcome, LevelBegins) or group.number not in self._groups:
            self._used_px -= group.num_px
            if isinstance(outcome, LevelBegins):
                group.rank, group.num_px = outcome.rank, outcome.num_px
                heapq.heappush(self._paused, (group.rank, next(self._order), group.number))
                outcome = ()
            self._resume()
        self._send(group.number, outcome)

    def _resume(self) -> None:
        """Start levels that fit into the memory."""
        while self._paused:
            group = self._groups[self._paused[0][2]]
            if self._used_px and self._used_px + group.num_px > MAX_ACTIVE_PX:
                return
            heapq.heappop(self._paused)
            self._used_px += group.num_px
            self._enqueue(group, ())

    def _send(self, number: int, outcome: object) -> None:
        """Send the requests or the result of a group, and the number of open tasks."""
        self._connection.send((number, outcome, len(self._ready) + len(self._tasks), self._num_taken))

    def _acquire(self, config: bytes) -> "GroupDecoder":
        """Return an idle decoder of a configuration."""
        from decoder.group import GroupDecoder
        from decoder.wyner_ziv import WynerZivDecoder

        if config != self._config:
            self._config, self._idle = config, []
            self._frames = WynerZivDecoder(decode_config(config))
        return self._idle.pop() if self._idle else GroupDecoder(decode_config(config), self._frames)

    def _release(self, decoder: "GroupDecoder", config: bytes) -> None:
        """Keep a decoder that has not failed."""
        if config == self._config:
            self._idle.append(decoder)


def _portable(err: Exception) -> Exception:
    """Return an error of a class that the parent process can load."""
    if isinstance(err, DvcError):
        return err
    error = RuntimeError(repr(err))
    error.add_note(f"in the decoding process:\n{''.join(traceback.format_exception(err))}")
    return error


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
