"""The decoder's end of a live run: groups of pictures and bits from an encoder behind a connection.

Groups that begin with a key frame do not depend on each other: many are in flight, so that a long way to the
encoder and back is waited for once for all of them, not once for each request. What is asked for, and so
every bit, is what one group after the other would ask for.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from decoder.parallel import DecodingProcess
from decoder.tasks import Answered, DecodedGroup, GroupTask, following
from dvc.config import CodecConfig
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback import MAX_OPEN_GOPS, Connection, DecoderEndpoint, Event, Gop, Hello, ParityAnswer

MAX_PX_IN_FLIGHT = 2**25
"""Pixels of all frames of the groups in flight, which bounds memory; the protocol bounds their number."""


class LiveSource:
    """The endpoint of the feedback channel with its connection.

    Parameters
    ----------
    connection : Connection
        The encoder.

    Raises
    ------
    FeedbackError
        If the encoder breaks the protocol, falls silent or goes away; here and in all methods.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.endpoint = DecoderEndpoint()
        self._events: deque[Event] = deque()
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
        """Tell the encoder that the decoder cannot go on.

        Parameters
        ----------
        reason : str
            Why, in one line.
        """
        self.endpoint.send_failure(reason)
        self.flush()


class GroupsInFlight:
    """Groups of pictures that are decoded at the same time, and what they ask for.

    Parameters
    ----------
    source : LiveSource
        The encoder.
    processes : sequence of DecodingProcess
        Who decodes.
    task_of : callable
        Decodes the key frame of a group: see `decoder.session`.
    """

    def __init__(
        self,
        source: LiveSource,
        processes: Sequence[DecodingProcess],
        task_of: Callable[[Gop], GroupTask],
    ) -> None:
        self._source, self._endpoint = source, source.endpoint
        self._processes = processes
        self._task_of = task_of
        self._asked: dict[tuple[int, int], tuple[int, DecodingProcess]] = {}  # by frame and plane
        self._chained: dict[int, GroupTask] = {}  # wait for the last frame of the group before
        self._ends: dict[int, DecodedGroup] = {}  # have it
        self._outcomes: dict[int, DecodedGroup | Exception] = {}
        self._damaged = False

    def decode(self) -> Iterator[DecodedGroup]:
        """Decode what the encoder sends.

        Yields
        ------
        DecodedGroup
            In display order; `window` of them are in flight or wait to be yielded.

        Raises
        ------
        BitstreamError, FeedbackError
            If the encoder sends what cannot be decoded; all groups before have been yielded then.
        """
        for _ in range(window(self._source.config)):
            self._endpoint.send_next_gop()
        number = 0
        while not self._endpoint.finished:
            self._source.flush()
            self._go_on()
            while (outcome := self._outcomes.pop(number, None)) is not None:
                if isinstance(outcome, Exception):
                    raise outcome
                yield outcome
                number += 1
                self._endpoint.send_next_gop()
        self._source.flush()

    def _go_on(self) -> None:
        """Wait until something comes, from the encoder or from a process, and pass it on."""
        connection = self._source.connection
        idle = not any(process.num_running for process in self._processes)
        for ready in connection.wait(self._processes, patient=not (idle or self._asked)):
            if ready is connection:
                for event in self._source.receive():
                    self._take(event)
            else:
                self._pass_on(ready)

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
                number, process = self._asked.pop((frame, plane))
                process.submit(Answered(number, (frame, plane), bits))

    def _submit(self, task: GroupTask) -> None:
        min(self._processes, key=lambda process: process.num_running).submit(task)

    def _pass_on(self, process: DecodingProcess) -> None:
        number, outcome = process.receive()
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
            for request in outcome:
                self._asked[request.frame, request.plane] = number, process
                self._endpoint.send_request(request)


def window(config: CodecConfig) -> int:
    """Return how many groups of pictures are in flight at most.

    Parameters
    ----------
    config : CodecConfig
        Tells how large they are.

    Returns
    -------
    int
        From 2 to `MAX_OPEN_GOPS`.
    """
    video = config.video
    group_px = video.width * video.height * config.gop.length
    return min(max(MAX_PX_IN_FLIGHT // group_px, 2), MAX_OPEN_GOPS)
