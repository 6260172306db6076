"""The decoder's end of a live run: groups of pictures and bits from an encoder behind a connection.

Many groups are in flight, so that the round-trip time to the encoder is waited for once for all of them. The
requests, and so every bit, are the same as if groups were decoded one after the other. Many requests go in
one message: each message costs the encoder, which should be cheap, more than the bits that it requests.
"""

import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import wait

from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.processes import DecodingProcess
from dvc.config import CodecConfig
from dvc.errors import BitstreamError, ConnectionLostError, FeedbackError, NobodyListensError, RefusedError
from dvc.feedback import (
    Connection,
    DecoderEndpoint,
    Dialler,
    Event,
    Gop,
    ParityAnswer,
    Readable,
    max_open_gops,
)
from dvc.feedback.messages import DECODER_ID_BYTES
from dvc.slepian_wolf import ParityRequest, Place

HELD_SHARE = 1 / 16
"""Share of the turnaround time for which requests are held while the decoder has other work."""
NUM_TURNAROUNDS = 256
"""Number of recent answers; the quickest gives the round-trip time of the encoder."""
STEP_MEMORY = 1 / 16
"""Weight of the latest step of decoding in the mean duration of steps."""
ATTEMPT_S = 5.0
"""Longest attempt to connect again."""
RETRY_S = 0.2
"""Pause between two attempts to connect."""


@dataclass
class LinkReport:
    """Lost connections, and their cost."""

    num_reconnections: int = 0
    away_s: float = 0.0
    groups_sent_again: int = 0


class LiveSource:
    """A live encoder; a lost connection is replaced by another one."""

    def __init__(
        self,
        dialler: Dialler,
        patience_s: float = 0.0,
        log: Callable[[str], None] = lambda _: None,
        stop: Readable | None = None,
    ) -> None:
        self.report = LinkReport()
        self.num_asked = 0  # requests without an answer, held or sent
        self.num_groups = self.num_frames = 0  # written
        self.tasks: dict[int, GroupTask] = {}  # of groups that are not written, by number
        self._dialler, self._patience_s, self._log, self._stop = dialler, patience_s, log, stop
        self._decoder_id = secrets.token_bytes(DECODER_ID_BYTES)
        self.connection, self.endpoint = self._connect(None)
        self.config: CodecConfig = self.endpoint.config
        self.heard_s = time.monotonic()  # time of the last whole message

    def _connect(self, lost: ConnectionLostError | None) -> tuple[Connection, DecoderEndpoint]:
        """Connect, again and again if the encoder does not listen or a connection has been lost."""
        is_first, started_s = lost is None, time.monotonic()
        patience_s = self._dialler.timeout_s if lost is None else self._patience_s
        while True:
            left_s = started_s + patience_s - time.monotonic()
            try:
                return self._greet(self._dialler.timeout_s if is_first else min(left_s, ATTEMPT_S))
            except RefusedError:
                raise
            except NobodyListensError as err:
                if self._is_complete:
                    raise
                lost = lost or err
            except ConnectionLostError as err:
                if is_first and self._patience_s:
                    is_first, started_s, patience_s = False, time.monotonic(), self._patience_s
                    self._log(f"{err}; trying again for {patience_s:g} s")
                elif is_first:
                    raise
                lost = err
            except FeedbackError:  # on a damaged connection, or not the encoder
                if is_first:
                    raise
            if time.monotonic() + RETRY_S > started_s + patience_s:
                away = "" if is_first else f"; it has not come back for {patience_s:g} s"
                raise ConnectionLostError(f"{lost}{away}")
            if self._stop is not None and wait([self._stop], RETRY_S):  # type: ignore[list-item]
                raise KeyboardInterrupt
            time.sleep(RETRY_S if self._stop is None else 0.0)

    def _greet(self, within_s: float) -> tuple[Connection, DecoderEndpoint]:
        """Connect once, and exchange the hello and the welcome."""
        deadline_s = time.monotonic() + within_s
        connection = self._dialler.connect(min(within_s, ATTEMPT_S), self._stop)
        endpoint = DecoderEndpoint(
            self._decoder_id, self.num_groups, self.num_frames, self._dialler.protection.token
        )
        try:
            connection.send(endpoint.bytes_to_send(), within_s)
            while not endpoint.is_welcome:
                left_s = deadline_s - time.monotonic()
                if left_s <= 0.0:
                    raise connection.lose(f"is silent for {within_s:g} s")
                endpoint.receive(connection.receive(left_s))
        except BaseException:
            connection.close(0.0)
            raise
        return connection, endpoint

    @property
    def _is_complete(self) -> bool:
        """Whether the whole sequence is written."""
        return self.num_groups > 0 and self.endpoint.flow.all_done

    def reconnect(self, lost: ConnectionLostError) -> bool:
        """Replace a lost connection; return False if all is written and the encoder has ended."""
        lost_s = time.monotonic()
        self.connection.close(0.0)
        if not self._patience_s and not self._is_complete:
            raise lost
        try:
            self.connection, self.endpoint = self._connect(lost)
        except ConnectionLostError:
            if self._is_complete:
                return False
            raise
        if self.endpoint.config != self.config:
            raise FeedbackError("the encoder serves another sequence now")
        self.report.num_reconnections += 1
        self.heard_s = time.monotonic()
        self.report.away_s = round(self.report.away_s + self.heard_s - lost_s, 3)
        self.num_asked = 0
        return True

    def flush(self) -> None:
        """Send the messages of the endpoint."""
        self.connection.send(self.endpoint.bytes_to_send())

    def abort(self, reason: str) -> None:
        """Report to the encoder that the decoder ends the run."""
        self.endpoint.send_failure(reason)
        self.flush()

    def close(self) -> None:
        """Close the connection."""
        self.connection.close()


class HeldRequests:
    """Requests that are held, so that the encoder receives and answers many at once."""

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
        """Record the turnaround time of an answer."""
        self._turnarounds_s.append(self._clock() - self._sent_s.pop(place))

    def stepped(self, step_s: float) -> None:
        """Record the duration of a step of decoding, from one request to the next."""
        self._step_s += STEP_MEMORY * (step_s - self._step_s)

    def left_s(self, num_steps: int) -> float:
        """Return how much longer the requests may be held."""
        turnaround_s = min(self._turnarounds_s, default=0.0)
        work_s = num_steps * self._step_s - turnaround_s
        pause_s = self._since_s + HELD_SHARE * turnaround_s - self._clock()
        return max(0.0, work_s, pause_s) if num_steps else 0.0

    def take(self) -> list[ParityRequest]:
        """Return and forget the requests, which are sent now."""
        requests, self._held = self._held, []
        now_s = self._clock()
        self._sent_s |= {(request.frame, request.run): now_s for request in requests}
        return requests


class LiveGroups:
    """The groups of a live encoder that come on one connection; see `decoder.processes.GroupSource`."""

    def __init__(
        self, source: LiveSource, task_of: Callable[[Gop], GroupTask], stop: Readable | None = None
    ) -> None:
        self._source, self._endpoint = source, source.endpoint
        self._task_of = task_of
        self._stop = [] if stop is None else [stop]
        self._events: list[Event] = []
        self._held = HeldRequests()
        self._holding: set[DecodingProcess] = set()  # the processes that made these requests
        self._arrived_s: dict[int, float] = {}
        self._num_messages = 0
        self._damaged = False
        # After a lost connection one group comes first, so that each connection leads to some progress.
        self._max_open = max_open_gops(source.config)
        self._window = 1 if source.report.num_reconnections else self._max_open
        self._fill_window()

    @property
    def finished(self) -> bool:
        """Whether the encoder knows that the whole sequence is written."""
        return self._endpoint.finished

    def poll(self) -> Iterator[GroupTask | ParityAnswer | BitstreamError]:
        """Return the groups and answers that the encoder has sent."""
        events, self._events = self._events, []
        for event in events:
            match event:
                case Gop() if not self._damaged:
                    self._arrived_s[event.number] = time.monotonic()
                    tasks, number = self._source.tasks, event.number
                    try:
                        if number not in tasks:  # its key frame is decoded when it comes for the first time
                            tasks[number] = self._task_of(event)
                        elif tasks[number].record != event.record:
                            raise BitstreamError(
                                f"group of pictures {number} differs from the one that came before"
                            )
                        else:
                            self._source.report.groups_sent_again += 1
                        yield tasks[number]
                    except BitstreamError as err:
                        self._damaged = True
                        yield err
                case ParityAnswer(frame, run):
                    self._held.answered((frame, run))
                    self._source.num_asked -= 1
                    yield event

    def wait(self, processes: Sequence[DecodingProcess]) -> Iterator[DecodingProcess]:
        """Wait for the encoder, for processes or for the end of a pause; then send requests."""
        source = self._source
        source.flush()
        connection = source.connection
        # The encoder may wait for its camera, but not before it answers.
        patient = source.num_asked == len(self._held) and not self._endpoint.flow.all_done
        held_s, silent_s = self._held_s(), source.heard_s + connection.timeout_s - time.monotonic()
        bounds_s = [bound_s for bound_s in (held_s, None if patient else silent_s) if bound_s is not None]
        within_s = max(0.0, min(bounds_s)) if bounds_s else None
        for ready in connection.wait([*processes, *self._stop], within_s):
            if ready in self._stop:
                raise KeyboardInterrupt
            if ready is connection:
                events = self._endpoint.receive(connection.receive(0.0))
                if events:
                    source.heard_s = time.monotonic()
                self._events += events
            else:
                yield ready
                self._held.stepped(ready.step_s)
        now_s = time.monotonic()
        if patient:
            source.heard_s = now_s
        elif now_s > source.heard_s + connection.timeout_s:
            raise connection.lose(f"is silent for {connection.timeout_s:g} s")
        if self._held_s() == 0.0:
            self._endpoint.send_requests(self._held.take())
            self._num_messages += 1
            source.flush()  # now, since the consumer of the frames may not come back soon
            self._holding.clear()

    def request(self, requests: Sequence[ParityRequest], process: DecodingProcess) -> None:
        """Hold requests until they are sent together."""
        self._source.num_asked += len(requests)
        self._held.add(requests)
        self._holding |= {process} if requests else set()

    def _held_s(self) -> float | None:
        """Return how much longer requests are held, if any are."""
        if not self._held:
            return None
        return self._held.left_s(min(process.num_pending for process in self._holding))

    def consumed(self) -> None:
        """Confirm a group that is written, and ask for another one."""
        source = self._source
        task = source.tasks.pop(source.num_groups)
        self._endpoint.send_gop_done(task.number)
        source.num_groups, source.num_frames = task.number + 1, task.last_index + 1
        self._window = min(2 * self._window, self._max_open)
        self._fill_window()

    def _fill_window(self) -> None:
        flow = self._endpoint.flow
        while not flow.ended and flow.num_credits + len(flow.open) < self._window:
            self._endpoint.send_next_gop()

    def timed(self, groups: Iterable[DecodedGroup]) -> Iterator[DecodedGroup]:
        """Add to decoded groups their delay, and the number of messages that they took."""
        for group in groups:
            delay_s = time.monotonic() - self._arrived_s.pop(min(self._arrived_s))
            num_messages, self._num_messages = self._num_messages, 0
            yield replace(group, delay_s=delay_s, num_messages=num_messages)
