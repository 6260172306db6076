"""The encoder's end of a live run: sends groups while a decoder has room, answers its requests."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np

from dvc.errors import BitstreamError, DvcError, FeedbackError, SupersededError
from dvc.feedback import EncoderEndpoint, Event, GopDone, Link, LinkCounts
from dvc.slepian_wolf import RequestTable
from dvc.slepian_wolf.requests import COUNT, SLOT
from dvc.video import Frame
from encoder.door import Entered, give_up
from encoder.groups_ahead import GroupsAhead
from encoder.kept_groups import KeptGroup, KeptGroups
from encoder.pacing import DecoderPace
from encoder.session import EncoderSession, Progress

MAX_STALL_S = 3600.0
"""Longest time without progress: a decoder that is alive but does nothing is given up."""
LOOK_S = 0.1
"""Longest wait for a decoder where frames may come meanwhile, of which a group is encoded ahead."""


@dataclass
class LinkReport(LinkCounts):
    """How often connections were lost, and decoders, and what that cost."""

    num_decoders: int = 1
    groups_begun_again: int = 0  # by decoders that came in place of others
    bits_asked_again: int = 0  # that decoders before had asked for of these groups
    frames_lost: list[list[int]] = field(default_factory=list)  # that no decoder has written: first and last

    def add(self, counts: LinkCounts) -> None:
        """Count what a link has gone through that is over."""
        self.num_reconnections += counts.num_reconnections
        self.away_s = round(self.away_s + counts.away_s, 3)
        self.bytes_sent_again += counts.bytes_sent_again


def serve(
    session: EncoderSession,
    frames: Iterable[Frame | None],
    link: Link,
    progress: Progress,
    pace: DecoderPace | None = None,
    endpoint: EncoderEndpoint | None = None,
    next_decoder: Callable[[], Entered] | None = None,
    ahead: GroupsAhead | None = None,
) -> dict[str, object]:
    """Encode a sequence for a decoder at the other end of a link, answering its requests.

    Where it does not come back, another one may in its place. `ahead`: where groups wait that it has no room
    for; else it is the frames that wait. Returns what the links went through.
    """
    endpoint = endpoint or EncoderEndpoint(session.config)
    quiet = DecoderPace(session.config.video.frame_rate, lambda _: None)
    live = _LiveEncoder(session, frames, link, endpoint, progress, pace or quiet, ahead)
    try:
        with session.statistics.coding():
            while not live.run():
                assert next_decoder is not None
                live.begin_again(*next_decoder())
    except FeedbackError as err:
        raise FeedbackError(f"{err}{live.unfinished}") from err
    except (DvcError, KeyboardInterrupt) as err:
        with suppress(FeedbackError):
            give_up(live.link, live.endpoint, str(err) or "interrupted")
        raise
    finally:
        live.link.close()
    live.report.add(live.link.counts)
    return asdict(live.report)


class _OpenGroup(NamedTuple):
    """A group that a decoder works at."""

    group: KeptGroup
    slots: range  # of its Wyner-Ziv frames


class _LiveEncoder:
    """State of a live run."""

    def __init__(
        self,
        session: EncoderSession,
        frames: Iterable[Frame | None],
        link: Link,
        endpoint: EncoderEndpoint,
        progress: Progress,
        pace: DecoderPace,
        ahead: GroupsAhead | None,
    ) -> None:
        self.link, self.endpoint, self.report = link, endpoint, LinkReport()
        self._ahead, self._exhausted = ahead, False
        self._pace, self._session, self._progress = pace, session, progress
        self._source = session.groups(frames)
        config = session.config
        self._kept = KeptGroups(endpoint.num_slots + 2 * config.gop.length + config.key.intra_period)
        self._num_groups = self._num_frames = self._num_written = 0  # of the sequence
        self._begin(deque())

    def _begin(self, again: deque[KeptGroup]) -> None:
        """Begin with a decoder, which is sent some groups before further ones."""
        self._again, self._ended = again, False
        self._open: dict[int, _OpenGroup] = {}
        self._buffer = self._session.encoder_buffer(self.endpoint.num_slots)
        self._num_bits = np.zeros(self.endpoint.num_slots, np.int64)  # that were asked for, of each frame
        self._progressed_s = time.monotonic()

    def begin_again(self, link: Link, endpoint: EncoderEndpoint) -> None:
        """Go on with another decoder: at an IDR picture, before the frames that none has written."""
        self.report.add(self.link.counts)
        self.report.num_decoders += 1
        self.link.close()
        self.report.bits_asked_again += sum(map(self._bits_of, self._open.values()))
        self.link, self.endpoint = link, endpoint
        again = self._kept.begin_again()
        if not again:
            self._session.begin_again(self._num_groups)
            while not again and self._next_group():
                again = self._kept.begin_again()
        endpoint.first_frame = again[0].first_frame if again else self._num_frames
        if endpoint.first_frame > self._num_written:
            self.report.frames_lost.append([self._num_written, endpoint.first_frame - 1])
            self._num_written = endpoint.first_frame
        self.report.groups_begun_again += len(again)
        self._pace.begin_again(sum(group.encoded.record.num_frames for group in again if not group.done))
        if self._session.limiter is not None:
            self._session.limiter.drop(again[0].number if again else self._num_groups - 1)
        self._begin(deque(again))

    @property
    def unfinished(self) -> str:
        """Name frames that were encoded, and that no decoder has said to have written."""
        if self._num_written == self._num_frames:
            return ""
        return f"; frames {self._num_written} to {self._num_frames - 1} are not known to be decoded"

    def run(self) -> bool:
        """Serve a decoder; tell whether it has got all, so that no other one has come in its place."""
        try:
            with ExitStack() as answering:
                while not self.endpoint.finished:
                    self._step(answering)
        except SupersededError:
            return False
        return True

    def _step(self, answering: ExitStack) -> None:
        wanted = self.endpoint.num_credits > 0 and not self._ended and self._has_room()
        if not wanted and not self._ended:
            self._pace.waits()
        works_ahead = not (wanted or self._exhausted or self._ahead is None) and self._ahead.can_grow
        if wanted or works_ahead:
            answering.close()
            self._encode_ahead() if works_ahead else self._send_group()
            answering.enter_context(self._session.statistics.timing("parity_cpu_s"))
        self.link.send(self.endpoint.bytes_to_send())
        if self._is_ready(busy=wanted or works_ahead):
            self._take(self.endpoint.receive(self.link.receive()))

    def _is_ready(self, busy: bool) -> bool:
        """Tell whether to receive something, which may be waited for."""
        if busy:
            return self.link.has_received()
        return self._ahead is None or self._exhausted or bool(self.link.wait(at_most_s=LOOK_S))

    def _has_room(self) -> bool:
        """Tell whether another group may be open."""
        limiter = self._session.limiter
        most = None if limiter is None else limiter.max_open_groups
        return most is None or len(self._open) < most

    def _take(self, events: Sequence[Event]) -> None:
        now_s = time.monotonic()
        if not events and now_s - self._progressed_s > MAX_STALL_S:
            raise FeedbackError(f"the other side is alive, but does nothing for {MAX_STALL_S:g} s")
        self._progressed_s = now_s if events else self._progressed_s
        for event in events:
            if isinstance(event, RequestTable):
                self._answer(event)
            elif isinstance(event, GopDone):
                self._done(self._open.pop(event.number))

    def _done(self, done: _OpenGroup) -> None:
        """Notice that a decoder has written a group."""
        group = done.group
        if not group.done:
            group.done = True
            if self._session.limiter is not None:
                self._session.limiter.account(group.number, self._num_bits[done.slots])
            self._num_written = max(self._num_written, group.end_frame)
            num_frames = group.encoded.record.num_frames
            self._pace.done(num_frames)
            self._progress(num_frames)
        self._kept.drop_done()

    def _encode(self) -> KeptGroup | None:
        """Encode the next group of the source, if there is one."""
        group = next(self._source, None)
        if group is None:
            self._exhausted = True
            return None
        kept = KeptGroup(self._num_groups, self._num_frames, self._session.encode(group))
        self._num_groups, self._num_frames = kept.number + 1, kept.end_frame
        return kept

    def _encode_ahead(self) -> None:
        group = self._encode()
        if group is not None and self._ahead is not None:
            with self._session.statistics.timing("writing_cpu_s"):
                self._ahead.add(group)

    def _next_group(self) -> KeptGroup | None:
        """Return the next group that a decoder gets, if there is one."""
        group = (self._ahead and self._ahead.take()) or self._encode()
        if group is not None:
            self._kept.add(group)
            self._pace.sent(group.encoded.record.num_frames)
        return group

    def _send_group(self) -> None:
        group = self._again.popleft() if self._again else self._next_group()
        self._progressed_s = time.monotonic()  # however long the source took
        if group is None:
            self.endpoint.send_end()
            self._ended = True
            return
        with self._session.statistics.timing("writing_cpu_s"):
            number = self.endpoint.send_gop(group.encoded.record)
        first, frames = self.endpoint.first_slot(number), group.encoded.frames
        slots = range(first, first + len(frames))
        self._open[number] = _OpenGroup(group, slots)
        self._num_bits[slots] = 0
        for slot, frame in zip(slots, frames, strict=True):
            self._buffer.enter(slot, frame)

    def _bits_of(self, group: _OpenGroup) -> int:
        """Return how many bits were asked for of an open group."""
        return int(self._num_bits[group.slots].sum())

    def _answer(self, requests: RequestTable) -> None:
        try:
            bits = self._buffer.answer(requests)
        except (ValueError, BitstreamError) as err:  # no such bit in this frame, no areas
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        np.add.at(self._num_bits, requests.rows[:, SLOT], requests.rows[:, COUNT])
        self.endpoint.send_answers(bits)
