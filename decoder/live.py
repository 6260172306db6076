"""The decoder's end of a live run: groups of pictures and bits from an encoder behind a connection.

Groups do not depend on each other: many are in flight, so that a long way to the
encoder and back is waited for once for all of them, not once for each request. What is asked for, and so
every bit, is what one group after the other would ask for. Requests go many at a time: each message costs the
encoder, which is to be cheap, more than the bits that it asks for.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.processes import DecodingProcess
from dvc.config import CodecConfig
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback import (
    DecoderEndpoint,
    Event,
    Gop,
    Hello,
    Link,
    ParityAnswer,
    max_open_gops,
)
from dvc.feedback.link import Readable
from dvc.slepian_wolf import ParityRequest, Place

HELD_SHARE = 1 / 16
"""Of the time that answers take, for which requests wait for others as long as there is anything to do."""
NUM_TURNAROUNDS = 256
"""Latest answers, the quickest of which tells how far away the encoder is."""
STEP_MEMORY = 1 / 16
"""Weight of the latest step of decoding in the mean time that one takes."""


class LiveSource:
    """The endpoint of the feedback channel with its link."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.endpoint = DecoderEndpoint()
        self.num_asked = 0  # requests without an answer yet, held or sent
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
        return self.endpoint.receive(self.link.receive())

    def flush(self) -> None:
        """Send what the endpoint has for the encoder."""
        self.link.send(self.endpoint.bytes_to_send())

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
        self._sent_s |= {(request.frame, request.run): now_s for request in requests}
        return requests


class LiveGroups:
    """The groups of a live encoder; see `decoder.processes.GroupSource`."""

    def __init__(
        self, source: LiveSource, task_of: Callable[[Gop], GroupTask], stop: Readable | None = None
    ) -> None:
        self._source, self._endpoint = source, source.endpoint
        self._task_of = task_of
        self._stop = [] if stop is None else [stop]
        self._events: list[Event] = []
        self._held = HeldRequests()
        self._holding: set[DecodingProcess] = set()  # whose requests these are
        self._arrived_s: dict[int, float] = {}
        self._num_messages = self._num_taken = 0
        self._damaged = False
        for _ in range(max_open_gops(source.config)):
            self._endpoint.send_next_gop()

    @property
    def finished(self) -> bool:
        """Whether the encoder has said so."""
        return self._endpoint.finished

    def received(self) -> Iterator[GroupTask | ParityAnswer | BitstreamError]:
        """Read what the encoder has sent."""
        events, self._events = self._events, []
        for event in events:
            match event:
                case Gop() if not self._damaged:
                    self._arrived_s[event.number] = time.monotonic()
                    try:
                        yield self._task_of(event)
                    except BitstreamError as err:
                        self._damaged = True
                        yield err
                case ParityAnswer(frame, run):
                    self._held.answered((frame, run))
                    self._source.num_asked -= 1
                    yield event

    def wait(self, processes: Sequence[DecodingProcess]) -> Iterator[DecodingProcess]:
        """Wait for the encoder, for processes or for the end of a pause; then send requests."""
        self._source.flush()
        link = self._source.link
        idle = not any(process.num_running for process in processes)
        patient = self._source.num_asked == len(self._held) and not idle
        for ready in link.wait([*processes, *self._stop], patient, self._held_s()):
            if ready in self._stop:
                raise KeyboardInterrupt
            if ready is link:
                self._events += self._source.receive()
            else:
                yield ready
                self._held.stepped(ready.step_s)
        if self._held_s() == 0.0:
            self._endpoint.send_requests(self._held.take())
            self._num_messages += 1
            self._source.flush()  # not only when whoever takes the frames comes back
            self._holding.clear()

    def ask(self, requests: Sequence[ParityRequest], process: DecodingProcess) -> None:
        """Hold requests until they are sent together."""
        self._source.num_asked += len(requests)
        self._held.add(requests)
        self._holding |= {process} if requests else set()

    def _held_s(self) -> float | None:
        """Return how much longer requests are held, if any are."""
        if not self._held:
            return None
        return self._held.left_s(min(process.num_pending for process in self._holding))

    def taken(self) -> None:
        """Let the encoder forget a group that whoever takes the frames has written, and send another."""
        self._endpoint.send_gop_done(self._num_taken)
        self._num_taken += 1
        self._endpoint.send_next_gop()

    def timed(self, groups: Iterable[DecodedGroup]) -> Iterator[DecodedGroup]:
        """Note of decoded groups how late they are, and how many messages they took."""
        for group in groups:
            delay_s = time.monotonic() - self._arrived_s.pop(min(self._arrived_s))
            num_messages, self._num_messages = self._num_messages, 0
            yield replace(group, delay_s=delay_s, num_messages=num_messages)
