"""Groups of pictures that are decoded at the same time, in processes of their own.

A stream and a live encoder are decoded alike: a source gives groups in order of display, processes decode
them, and what they ask for goes to the source. Requests for frames of a stream never come here: the process
finds the answers in the record of the group.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from multiprocessing.connection import wait
from typing import Any, Protocol, cast

from decoder.processes import DecodingProcess, decoding_process
from decoder.tasks import Answered, DecodedGroup, GroupTask
from dvc.errors import BitstreamError
from dvc.feedback import ParityAnswer
from dvc.slepian_wolf import ParityRequest, Place

CHAINS_PER_PROCESS = 2
"""One that a process is at, and one that it goes on with while whoever takes the frames is busy."""


class GroupSource(Protocol):
    """Gives groups to be decoded, and gets what is asked for them."""

    @property
    def finished(self) -> bool:
        """Whether there are no more groups to come."""

    def received(self) -> Iterable[GroupTask | ParityAnswer | BitstreamError]:
        """Return what has come since the last call, without waiting; after damage nothing comes."""

    def wait(self, processes: Sequence[DecodingProcess]) -> Iterable[DecodingProcess]:
        """Wait until something comes from a process or to the source; return the processes."""

    def ask(self, requests: Sequence[ParityRequest], process: DecodingProcess) -> None:
        """Take requests of a process."""

    def decoded(self, number: int) -> None:
        """Notice that a group asks for nothing more."""

    def taken(self) -> None:
        """Notice that the next group has been handed on, so that there is room for another."""


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

    def decoded(self, number: int) -> None:
        """Do nothing: nobody waits for it."""

    def taken(self) -> None:
        """Make room once the last group of a chain is taken."""
        if self._open:
            self._open[0] -= 1
            if not self._open[0]:
                self._open.popleft()


class GroupsInFlight:
    """Groups of pictures that are decoded at the same time; the same bytes for any number of processes."""

    def __init__(self, source: GroupSource, jobs: int) -> None:
        self._source, self._jobs = source, jobs
        self._stack = ExitStack()
        self._processes: list[DecodingProcess] = []
        self._latest: DecodingProcess | None = None  # that got the last group
        self._asked: dict[Place, tuple[int, DecodingProcess]] = {}
        self._order: deque[int] = deque()  # of groups that are not handed on
        self._outcomes: dict[int, DecodedGroup | Exception] = {}

    def decode(self) -> Iterator[DecodedGroup]:
        """Decode what the source gives; what ends the run is raised after all groups before it."""
        failure: BaseException | None = None
        with self._stack:
            while failure is None and (self._order or not self._source.finished):
                try:
                    self._start_received()
                    if not self._is_ready():
                        for process in self._source.wait(self._processes):
                            self._pass_on(process)
                        self._start_received()
                except (Exception, KeyboardInterrupt) as err:
                    failure = err
                while self._is_ready():
                    outcome = self._outcomes.pop(self._order.popleft())
                    if isinstance(outcome, Exception):
                        raise outcome
                    yield outcome
                    self._source.taken()
        if failure is not None:
            raise failure

    def _is_ready(self) -> bool:
        return bool(self._order) and self._order[0] in self._outcomes

    def _start_received(self) -> None:
        """Hand on to processes what the source has."""
        tasks: list[GroupTask] = []
        for received in self._source.received():
            if isinstance(received, ParityAnswer):
                place = received.frame, received.plane
                number, process = self._asked.pop(place)
                process.submit(Answered(number, place, received.bits))
                continue
            number = -1 if isinstance(received, BitstreamError) else received.number
            self._order.append(number)
            if isinstance(received, BitstreamError):
                self._outcomes[number] = received
            elif received.record.wyner_ziv:
                tasks.append(received)
            else:
                self._end(number, DecodedGroup.of(received, []))
        num_running = sum(process.num_running for process in self._processes)
        while len(self._processes) < min(self._jobs, num_running + len(tasks)):
            self._processes.append(self._stack.enter_context(decoding_process()))
        for task in tasks:
            if self._latest is None or not task.follows:
                self._latest = min(self._processes, key=lambda process: process.num_running)
            self._latest.submit(task)

    def _pass_on(self, process: DecodingProcess) -> None:
        """Take what a process has: further requests, or how a group ended."""
        number, outcome = process.receive()
        if isinstance(outcome, DecodedGroup | Exception):
            self._end(number, outcome)
        else:
            self._asked |= {(request.frame, request.plane): (number, process) for request in outcome}
            self._source.ask(outcome, process)

    def _end(self, number: int, outcome: DecodedGroup | Exception) -> None:
        self._outcomes[number] = outcome
        if isinstance(outcome, DecodedGroup):
            self._source.decoded(number)
