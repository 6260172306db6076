"""The encoder's end of a live run: sends groups while the decoder has room, answers its requests."""

from collections.abc import Iterable
from fractions import Fraction
from typing import NamedTuple

from dvc.errors import FeedbackError, VideoError
from dvc.feedback import Connection, EncoderEndpoint, GopDone
from dvc.turbo import ParityRequest
from dvc.video import Frame
from dvc.wynerziv.buffered import EncodedFrame
from encoder.pacing import DecoderPace
from encoder.session import EncoderSession, Progress


def serve(
    session: EncoderSession,
    frames: Iterable[Frame],
    connection: Connection,
    progress: Progress,
    pace: DecoderPace | None = None,
) -> None:
    """Encode a sequence for a decoder at the other end of a connection, answering its requests.

    Parameters
    ----------
    session : EncoderSession
        Encoder of the sequence.
    frames : iterable of Frame
        The sequence; encoded as the decoder gets to it.
    connection : Connection
        The peer.
    progress : callable
        Called with the number of frames just finished.
    pace : DecoderPace, optional
        Told what the decoder has, and when it takes no more: it says how many groups may be open.

    Raises
    ------
    FeedbackError
        If the peer breaks the protocol, falls silent or goes away.
    """
    video = session.config.video
    quiet = DecoderPace(Fraction(video.frame_rate_num, video.frame_rate_den), lambda _: None)
    live = _LiveEncoder(session, frames, connection, progress, pace or quiet)
    try:
        with session.statistics.coding():
            live.run()
    except VideoError as err:
        live.give_up(str(err))
        raise


class _OpenGroup(NamedTuple):
    frames: dict[int, EncodedFrame]  # Wyner-Ziv frames by display position
    num_frames: int


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
        self._num_frames = 0
        self._ended = False
        self._open: dict[int, _OpenGroup] = {}

    def run(self) -> None:
        while not self._endpoint.finished:
            wanted = self._endpoint.num_credits > 0 and not self._ended
            if wanted:
                self._send_group()
            elif not self._ended:
                self._pace.waits()
            with self._session.statistics.timing("writing_cpu_s"):
                self._connection.send(self._endpoint.bytes_to_send())
            if wanted and not self._connection.has_received():
                continue
            for event in self._endpoint.receive(self._connection.receive()):
                if isinstance(event, ParityRequest):
                    self._answer(event)
                elif isinstance(event, GopDone):
                    num_frames = self._open.pop(event.number).num_frames
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
        frames = dict(enumerate(encoded.frames, self._num_frames))
        self._open[number] = _OpenGroup(frames, record.num_frames)
        self._num_frames += record.num_frames
        self._pace.sent(record.num_frames)

    def _answer(self, request: ParityRequest) -> None:
        frame = next(
            group.frames[request.frame] for group in self._open.values() if request.frame in group.frames
        )
        try:
            with self._session.statistics.timing("parity_cpu_s"):
                bits = frame.answer(request)
        except ValueError as err:  # no such plane in this frame: the ledger knows only what frames may have
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        self._endpoint.send_answer(request.frame, request.plane, bits)
