"""The decoder's end of a live run: groups of pictures and bits from an encoder behind a connection.

Groups that begin with a key frame do not depend on each other: many are in flight, so that a long way to the
encoder and back is waited for once for all of them, not once for each request. What is asked for, and so
every bit, is what one group after the other would ask for. Requests go many at a time: each message costs the
encoder, which is to be cheap, more than the bits that it asks for.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from decoder.parallel import DecodingProcess
from decoder.tasks import Answered, DecodedGroup, GroupTask, following
from dvc.config import CodecConfig
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback import (
    Connection,
    DecoderEndpoint,
    Event,
    Gop,
    Hello,
    ParityAnswer,
    max_open_gops,
)
from dvc.feedback.transport import Readable
from dvc.slepian_wolf import ParityRequest, Place

HELD_SHARE = 1 / 16
"""Of the time that answers take, for which requests wait for others as long as there is anything to do."""
NUM_TURNAROUNDS = 256
"""Latest answers, the quickest of which tells how far away the encoder is."""
STEP_MEMORY = 1 / 16
"""Weight of the latest step of decoding in the mean time that one takes."""


class LiveSource:
    """The endpoint of the feedback channel with its connection."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.endpoint = DecoderEndpoint()
        self._events: deque[Event] = deque()
        self.flush()
        while not self._events:
            self._events.extend(self.receive())
        if not isinstance(self._events.popleft(), Hello):
            raise FeedbackError("the encoder did not introduce itself")

    @property
    def config(self) -> CodecConfig:
        """Configuration of the sequence."""
        return self.endpoint.config

    def receive(self) -> Sequence[Event]:
        """Return what has come since the last call, waiting for it if nothing has."""
        if self._events:
            events = tuple(self._events)
            self._events.clear()
            return events
        return self.endpoint.receive(self.connection.receive())

    def flush(self) -> None:
        """Send what the endpoint has for the encoder."""
        self.connection.send(self.endpoint.bytes_to_send())

    def give_up(self, reason: str) -> None:
        """Tell the encoder that the decoder cannot go on."""
        self.endpoint.send_failure(reason)
        self.flush()


class HeldRequests:
    """Requests that wait for others, so that the encoder gets, and answers, many at once."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._held: list[ParityRequest] = []
        self._since_s = 0.0
        self._sent_s: dict[Place, float] = {}
        self._turnarounds_s: deque[float] = deque(maxlen=NUM_TURNAROUNDS)
        self._step_s = 0.0

    def __len__(self) -> int:
        return len(self._held)

    def add(self, requests: Sequence[ParityRequest]) -> None:
        """Hold some more requests."""
        if requests and not self._held:
            self._since_s = self._clock()
        self._held += requests

    def answered(self, place: Place) -> None:
        """Notice how long an answer has taken."""
        self._turnarounds_s.append(self._clock() - self._sent_s.pop(place))

    def stepped(self, step_s: float) -> None:
        """Notice how long a step of decoding has taken, from one request to the next."""
        self._step_s += STEP_MEMORY * (step_s - self._step_s)

    def left_s(self, num_steps: int) -> float:
        """Return how much longer the requests may be held."""
        turnaround_s = min(self._turnarounds_s, default=0.0)
        work_s = num_steps * self._step_s - turnaround_s
        pause_s = self._since_s + HELD_SHARE * turnaround_s - self._clock()
        return max(0.0, work_s, pause_s) if num_steps else 0.0

    def take(self) -> list[ParityRequest]:
        """Return the requests, which are sent now."""
        requests, self._held = self._held, []
        now_s = self._clock()
        self._sent_s |= {(request.frame, request.plane): now_s for request in requests}
        return requests


class GroupsInFlight:
    """Groups of pictures that are decoded at the same time, and what they ask for."""

    def __init__(
        self,
        source: LiveSource,
        processes: Sequence[DecodingProcess],
        task_of: Callable[[Gop], GroupTask],
        stop: Readable | None = None,
    ) -> None:
        self._stop = [] if stop is None else [stop]
        self._source, self._endpoint = source, source.endpoint
        self._processes = processes
        self._task_of = task_of
        self._held = HeldRequests()
        self._holding: set[DecodingProcess] = set()  # whose requests these are
        self._asked: dict[Place, tuple[int, DecodingProcess]] = {}  # held or sent
        self._chained: dict[int, GroupTask] = {}  # wait for the last frame of the group before
        self._ends: dict[int, DecodedGroup] = {}  # have it
        self._outcomes: dict[int, DecodedGroup | Exception] = {}
        self._damaged = False

    def decode(self) -> Iterator[DecodedGroup]:
        """Decode what the encoder sends."""
        for _ in range(max_open_gops(self._source.config)):
            self._endpoint.send_next_gop()
        number, failure = 0, None
        while not self._endpoint.finished and failure is None:
            try:
                self._source.flush()
                self._go_on()
            except (FeedbackError, KeyboardInterrupt) as err:
                failure = err  # after what is decoded already
            while (outcome := self._outcomes.pop(number, None)) is not None:
                if isinstance(outcome, Exception):
                    raise outcome
                yield outcome
                number += 1
                self._endpoint.send_next_gop()
        if failure is not None:
            raise failure
        self._source.flush()

    def _go_on(self) -> None:
        """Wait until something comes, from the encoder or from a process, and pass it on."""
        connection = self._source.connection
        idle = not any(process.num_running for process in self._processes)
        patient = len(self._asked) == len(self._held) and not idle
        for ready in connection.wait([*self._processes, *self._stop], patient, self._held_s()):
            if ready in self._stop:
                raise KeyboardInterrupt
            if ready is connection:
                for event in self._source.receive():
                    self._take(event)
            else:
                self._pass_on(ready)
        if self._held_s() == 0.0:
            self._endpoint.send_requests(self._held.take())
            self._source.flush()  # not only when whoever takes the frames comes back
            self._holding.clear()

    def _held_s(self) -> float | None:
        """Return how much longer requests are held, if any are."""
        if not self._held:
            return None
        return self._held.left_s(min(process.num_pending for process in self._holding))

    def _take(self, event: Event) -> None:
        match event:
            case Gop(number) if not self._damaged:
                try:
                    task = self._task_of(event)
                except BitstreamError as err:
                    self._outcomes[number], self._damaged = err, True
                    return
                if number == 0 or task.before is not None:
                    self._submit(task)
                elif number - 1 in self._ends:
                    self._submit(following(task, self._ends.pop(number - 1)))
                else:
                    self._chained[number] = task
            case ParityAnswer(frame, plane, bits):
                self._held.answered((frame, plane))
                number, process = self._asked.pop((frame, plane))
                process.submit(Answered(number, (frame, plane), bits))

    def _submit(self, task: GroupTask) -> None:
        min(self._processes, key=lambda process: process.num_running).submit(task)

    def _pass_on(self, process: DecodingProcess) -> None:
        number, outcome = process.receive()
        self._held.stepped(process.step_s)
        if isinstance(outcome, DecodedGroup):
            self._outcomes[number] = outcome
            self._endpoint.send_gop_done(number)
            if outcome.key is None:
                self._ends[number] = outcome
            if number + 1 in self._chained:
                self._submit(following(self._chained.pop(number + 1), self._ends.pop(number)))
        elif isinstance(outcome, Exception):
            self._outcomes[number] = outcome
        else:
            self._held.add(outcome)
            self._holding |= {process} if outcome else set()
            self._asked |= {(request.frame, request.plane): (number, process) for request in outcome}
