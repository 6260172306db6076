"""The encoder's end of a live run: sends groups while the decoder has room, answers its requests."""

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from fractions import Fraction

from dvc.errors import FeedbackError, VideoError
from dvc.feedback import Connection, EncoderEndpoint, Event, GopDone
from dvc.slepian_wolf import RequestTable
from dvc.video import Frame
from encoder.pacing import DecoderPace
from encoder.session import EncoderSession, Progress


def serve(
    session: EncoderSession,
    frames: Iterable[Frame],
    connection: Connection,
    progress: Progress,
    pace: DecoderPace | None = None,
) -> None:
    """Encode a sequence for a decoder at the other end of a connection, answering its requests."""
    video = session.config.video
    quiet = DecoderPace(Fraction(video.frame_rate_num, video.frame_rate_den), lambda _: None)
    live = _LiveEncoder(session, frames, connection, progress, pace or quiet)
    try:
        with session.statistics.coding():
            live.run()
    except VideoError as err:
        live.give_up(str(err))
        raise


class _LiveEncoder:
    """State of a live run."""

    def __init__(
        self,
        session: EncoderSession,
        frames: Iterable[Frame],
        connection: Connection,
        progress: Progress,
        pace: DecoderPace,
    ) -> None:
        self._pace = pace
        self._session = session
        self._source = session.groups(frames)
        self._connection = connection
        self._progress = progress
        self._endpoint = EncoderEndpoint(session.config)
        self._ended = False
        self._open = session.open_frames(self._endpoint.num_slots)
        self._num_frames: dict[int, int] = {}  # of open groups

    def run(self) -> None:
        with ExitStack() as answering:
            while not self._endpoint.finished:
                wanted = self._endpoint.num_credits > 0 and not self._ended
                if wanted:
                    answering.close()
                    self._send_group()
                    answering.enter_context(self._session.statistics.timing("parity_cpu_s"))
                elif not self._ended:
                    self._pace.waits()
                self._connection.send(self._endpoint.bytes_to_send())
                if not wanted or self._connection.has_received():
                    self._take(self._endpoint.receive(self._connection.receive()))

    def _take(self, events: Sequence[Event]) -> None:
        for event in events:
            if isinstance(event, RequestTable):
                self._answer(event)
            elif isinstance(event, GopDone):
                num_frames = self._num_frames.pop(event.number)
                self._pace.done(num_frames)
                self._progress(num_frames)

    def give_up(self, reason: str) -> None:
        self._endpoint.send_failure(reason)
        self._connection.send(self._endpoint.bytes_to_send())

    def _send_group(self) -> None:
        group = next(self._source, None)
        if group is None:
            self._endpoint.send_end()
            self._ended = True
            return
        encoded = self._session.encode(group)
        with self._session.statistics.timing("writing_cpu_s"):
            record = encoded.record(frame.header for frame in encoded.frames)
            number = self._endpoint.send_gop(record)
        for slot, frame in enumerate(encoded.frames, self._endpoint.first_slot(number)):
            self._open.enter(slot, frame)
        self._num_frames[number] = record.num_frames
        self._pace.sent(record.num_frames)

    def _answer(self, requests: RequestTable) -> None:
        try:
            bits = self._open.answer(requests)
        except ValueError as err:  # no such plane in this frame: the ledger knows only what frames may have
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        self._endpoint.send_answers(bits)
