"""The encoder's end of a live run: sends groups while a decoder has room, answers its requests."""

import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from fractions import Fraction

import numpy as np

from dvc.errors import BitstreamError, ConnectionLostError, DvcError, FeedbackError
from dvc.feedback import GopDone, max_open_gops
from dvc.slepian_wolf import RequestTable, plane_coder
from dvc.slepian_wolf.requests import COUNT, SLOT
from dvc.video import Frame
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.quantizer import FrameLayout
from encoder.acceptor import AcceptedPeer, PeerAcceptor
from encoder.encoder_session import EncodedGroup, EncoderSession, Progress
from encoder.frame_queue import LeftOut

MAX_STALL_S = 3600.0
"""Longest time that a connected decoder may take without asking for anything or finishing a group."""
LOOK_S = 0.02
"""Longest wait for the decoder while frames of the next group are awaited."""


@dataclass
class LinkReport:
    """Lost connections, and their cost."""

    num_reconnections: int = 0
    away_s: float = 0.0
    groups_sent_again: int = 0
    bits_asked_again: int = 0  # requested before for groups that were sent again


class DecoderPace:
    """Lag of a live decoder behind the video while its window of groups of pictures is full."""

    GROWTH = 4.0

    def __init__(
        self,
        frame_rate: Fraction,
        log: Callable[[str], None],
        left_out: LeftOut | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.behind_s = 0.0
        self.most_frames_open = 0
        self._interval_s = float(1 / frame_rate)
        self._log, self._clock, self._left_out = log, clock, left_out or LeftOut()
        self._start_s: float | None = None
        self._num_sent = self._num_done = 0
        self._logged_s = 1.0 / self.GROWTH

    def sent(self, num_frames: int) -> None:
        """Count frames that are sent to the decoder."""
        if self._start_s is None:
            self._start_s = self._clock()
        self._num_sent += num_frames
        self.most_frames_open = max(self.most_frames_open, self._num_sent - self._num_done)

    def done(self, num_frames: int) -> None:
        """Count frames that the decoder has written."""
        self._num_done += num_frames

    def waits(self) -> None:
        """Record that the decoder takes no more for now; log a lag that has grown."""
        if self._start_s is None:
            return
        left_out = self._left_out.frames
        behind_s = self._clock() - self._start_s - (self._num_sent + left_out) * self._interval_s
        self.behind_s = max(self.behind_s, behind_s)
        if behind_s >= self.GROWTH * self._logged_s:
            self._logged_s = behind_s
            self._log(
                f"the decoder is {behind_s:.1f} s behind the video: it has {self._num_sent - self._num_done}"
                f" frames up to number {self._num_sent - 1}, more frames wait; {left_out or 'none'} left out"
            )


def serve(
    session: EncoderSession,
    frames: Iterable[Frame | None],
    peers: PeerAcceptor | None,
    peer: AcceptedPeer,
    progress: Progress,
    pace: DecoderPace | None = None,
    patience_s: float = 0.0,
    has_frames: Callable[[], bool] = lambda: True,
) -> dict[str, object]:
    """Encode a sequence for a decoder, answering its requests; return the cost of lost connections.

    `has_frames` returns whether a group can be read without waiting; until then requests are answered.
    """
    quiet = DecoderPace(session.config.video.frame_rate, lambda _: None)
    live = _LiveEncoder(session, frames, peer, progress, pace or quiet, has_frames)
    try:
        live.serve(peers, patience_s)
    except FeedbackError as err:
        live.abort(str(err))
        raise FeedbackError(f"{err}{live.unfinished}") from err
    except (DvcError, KeyboardInterrupt) as err:
        live.abort(str(err) or "interrupted")
        raise
    finally:
        live.connection.close()
    return asdict(live.report)


@dataclass(eq=False)
class _SentGroup:
    """A group that the decoder has not confirmed."""

    number: int  # in the sequence
    first_frame: int
    num_frames: int
    encoded: EncodedGroup
    slots: range = range(0)  # slots of its Wyner-Ziv frames


class _LiveEncoder:
    """State of a live run, which outlives its connections."""

    def __init__(
        self,
        session: EncoderSession,
        frames: Iterable[Frame | None],
        peer: AcceptedPeer,
        progress: Progress,
        pace: DecoderPace,
        has_frames: Callable[[], bool],
    ) -> None:
        self.report, self._finished = LinkReport(), False
        self._session, self._progress, self._pace = session, progress, pace
        self._source, self._has_frames = session.groups(frames), has_frames
        self._num_groups = self._num_frames = 0  # encoded
        self._open: dict[int, _SentGroup] = {}  # by number
        self._first_frames = {0: 0}  # by number, if the decoder may continue there
        self._again: deque[_SentGroup] = deque()  # to be sent on this connection before further groups
        self._connect(peer)

    def _connect(self, peer: AcceptedPeer) -> None:
        self.connection, self._endpoint = peer
        self._ended = False
        config = self._session.config
        num_slots = max_open_gops(config) * config.gop.length
        self._buffer = EncoderBuffer(FrameLayout.of(config), plane_coder(config), num_slots)
        self._num_bits = np.zeros(num_slots, np.int64)  # requested, by slot
        self._progressed_s = time.monotonic()

    def serve(self, peers: PeerAcceptor | None, patience_s: float) -> None:
        """Serve the decoder until it has everything; after a lost connection it may come back."""
        if peers is not None:
            peers.first_frame = self._first_frames.get  # called by another thread
        with self._session.statistics.coding():
            while not self._finished:
                try:
                    self._run()
                except ConnectionLostError as err:
                    lost_s = time.monotonic()
                    returned = None if peers is None or not patience_s else peers.next_peer(patience_s)
                    while returned is not None and peers and (later := peers.next_peer(0.0)) is not None:
                        returned = later  # of several connections only the last is in use
                    if returned is not None:
                        self._resume(returned, lost_s)
                    elif self._ended and not self._open:
                        return
                    else:
                        away = f"; it has not come back for {patience_s:g} s" if patience_s else ""
                        raise FeedbackError(f"{err}{away}") from err

    def _resume(self, peer: AcceptedPeer, lost_s: float) -> None:
        """Continue on another connection after the groups that the decoder has."""
        hello = peer.endpoint.hello
        assert hello is not None
        if hello.num_groups not in self._first_frames:
            raise FeedbackError(f"the decoder cannot continue after {hello.num_groups} groups of pictures")
        self.connection.close()
        self.report.num_reconnections += 1
        self.report.away_s = round(self.report.away_s + time.monotonic() - lost_s, 3)
        for number in [number for number in self._open if number < hello.num_groups]:
            self._confirm(number)
        begun = [group for group in self._open.values() if group not in self._again]
        self.report.groups_sent_again += len(begun)
        self.report.bits_asked_again += sum(int(self._num_bits[group.slots].sum()) for group in begun)
        self._again = deque(self._open.values())
        self._connect(peer)

    @property
    def unfinished(self) -> str:
        """Clause that names the frames without confirmation."""
        if not self._open:
            return ""
        first = min(group.first_frame for group in self._open.values())
        return f"; frames {first} to {self._num_frames - 1} are not known to be decoded"

    def abort(self, reason: str) -> None:
        """Report to the decoder that the run ends."""
        self._endpoint.send_failure(reason)
        with suppress(FeedbackError):
            self.connection.send(self._endpoint.bytes_to_send())

    def _run(self) -> None:
        """Serve the decoder until it has everything, or the connection is lost."""
        with ExitStack() as answering:
            while not self._endpoint.finished:
                self._step(answering)
        self._finished = True
        with suppress(ConnectionLostError):
            self.connection.send(self._endpoint.bytes_to_send())

    def _step(self, answering: ExitStack) -> None:
        limiter = self._session.limiter
        limit = None if limiter is None else limiter.max_open_groups
        has_room = limit is None or len(self._open) - len(self._again) < limit
        may_send = self._endpoint.flow.num_credits > 0 and not self._ended and has_room
        sends = may_send and (bool(self._again) or self._has_frames())
        if sends:
            answering.close()
            self._send_group()
            answering.enter_context(self._session.statistics.timing("parity_cpu_s"))
        elif not (may_send or self._ended):
            self._pace.waits()
        self.connection.send(self._endpoint.bytes_to_send())
        within_s = 0.0 if sends else LOOK_S if may_send else MAX_STALL_S
        events = self._endpoint.receive(self.connection.receive(within_s))
        now_s = time.monotonic()
        if events:
            self._progressed_s = now_s
        elif now_s - self._progressed_s > MAX_STALL_S:
            raise FeedbackError(f"the other side is connected, but does nothing for {MAX_STALL_S:g} s")
        for event in events:
            if isinstance(event, RequestTable):
                self._answer(event)
            elif isinstance(event, GopDone):
                self._confirm(event.number)

    def _confirm(self, number: int) -> None:
        """Discard a group that the decoder has written."""
        group = self._open.pop(number)
        del self._first_frames[number]
        if self._session.limiter is not None:
            self._session.limiter.account(number, self._num_bits[group.slots])
        self._pace.done(group.num_frames)
        self._progress(group.num_frames)

    def _send_group(self) -> None:
        """Send the next group of the sequence, if there is one."""
        if self._again:
            group = self._again.popleft()
        elif (following := next(self._source, None)) is None:
            self._progressed_s = time.monotonic()
            self._endpoint.send_end()
            self._ended = True
            return
        else:
            encoded = self._session.encode(following)
            group = _SentGroup(self._num_groups, self._num_frames, encoded.record.num_frames, encoded)
            self._open[group.number] = group
            self._num_groups, self._num_frames = group.number + 1, group.first_frame + group.num_frames
            self._first_frames[self._num_groups] = self._num_frames
            self._pace.sent(group.num_frames)
        self._progressed_s = time.monotonic()  # the source may have taken long
        with self._session.statistics.timing("writing_cpu_s"):
            _, slot = self._endpoint.send_gop(group.encoded.record)
        group.slots = range(slot, slot + len(group.encoded.frames))
        self._num_bits[group.slots] = 0
        for number, frame in zip(group.slots, group.encoded.frames, strict=True):
            self._buffer.enter(number, frame)

    def _answer(self, requests: RequestTable) -> None:
        try:
            bits = self._buffer.answer(requests)
        except (ValueError, BitstreamError) as err:  # planes or areas that the frame does not have
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        np.add.at(self._num_bits, requests.rows[:, SLOT], requests.rows[:, COUNT])
        self._endpoint.send_answers(bits)
