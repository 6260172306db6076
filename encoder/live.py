"""The encoder's end of a live run: sends groups while a decoder has room, answers its requests."""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from typing import NamedTuple

import numpy as np

from dvc.config import CodecConfig
from dvc.errors import DvcError, FeedbackError
from dvc.feedback import Connection, EncoderEndpoint, Event, GopDone, Listener, Protection
from dvc.slepian_wolf import RequestTable
from dvc.slepian_wolf.requests import COUNT, SLOT
from dvc.video import Frame
from encoder.pacing import DecoderPace
from encoder.session import EncoderSession, Progress

HELLO_S = 5.0
"""Time that a peer has to say hello; until then it may be anybody, and others wait."""
MAX_STALL_S = 3600.0
"""Longest time without progress: a decoder that is alive but does nothing is given up."""


def await_decoder(
    listener: Listener,
    config: CodecConfig,
    timeout_s: float,
    say: Callable[[str], None],
    protection: Protection,
) -> tuple[Connection, EncoderEndpoint]:
    """Wait for a decoder that does its part of the protection; whoever else connects is turned away."""
    while True:
        connection = listener.accept(silence_timeout_s=timeout_s)
        try:
            connection.protect(protection, HELLO_S)
            return connection, greet(connection, config)
        except FeedbackError as err:
            say(f"not a decoder: {err}; still waiting")


def greet(connection: Connection, config: CodecConfig) -> EncoderEndpoint:
    """Wait for the hello of a decoder, and answer it; close the connection where none comes in time."""
    endpoint, deadline_s = EncoderEndpoint(config), time.monotonic() + HELLO_S
    try:
        while not endpoint.greeted:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0 or not connection.wait(patient=True, at_most_s=left_s):
                raise FeedbackError(f"the other side ({connection.name}) says no hello for {HELLO_S:g} s")
            endpoint.receive(connection.receive())
    except FeedbackError as err:
        with suppress(FeedbackError):
            _give_up(connection, endpoint, err)
        connection.close_within(min(1.0, deadline_s - time.monotonic()))
        raise
    except BaseException:
        connection.close()
        raise
    return endpoint


def _give_up(connection: Connection, endpoint: EncoderEndpoint, reason: object) -> None:
    """Tell the other side that this side ends the run."""
    endpoint.send_failure(str(reason))
    connection.send(endpoint.bytes_to_send())


def serve(
    session: EncoderSession,
    frames: Iterable[Frame | None],
    connection: Connection,
    progress: Progress,
    pace: DecoderPace | None = None,
    endpoint: EncoderEndpoint | None = None,
) -> None:
    """Encode a sequence for a decoder at the other end of a connection, answering its requests."""
    endpoint = endpoint or EncoderEndpoint(session.config)
    quiet = DecoderPace(session.config.video.frame_rate, lambda _: None)
    live = _LiveEncoder(session, frames, connection, endpoint, progress, pace or quiet)
    try:
        with session.statistics.coding():
            live.run()
    except FeedbackError:
        raise
    except (DvcError, KeyboardInterrupt) as err:
        _give_up(connection, endpoint, str(err) or "interrupted")
        raise


class _OpenGroup(NamedTuple):
    """A group that a decoder works at."""

    num_frames: int
    slots: slice  # of its Wyner-Ziv frames


class _LiveEncoder:
    """State of a live run."""

    def __init__(
        self,
        session: EncoderSession,
        frames: Iterable[Frame | None],
        connection: Connection,
        endpoint: EncoderEndpoint,
        progress: Progress,
        pace: DecoderPace,
    ) -> None:
        self._pace = pace
        self._session = session
        self._source = session.groups(frames)
        self._connection = connection
        self._progress = progress
        self._endpoint = endpoint
        self._progressed_s = time.monotonic()
        self._ended = False
        self._open = session.encoder_buffer(self._endpoint.num_slots)
        self._groups: dict[int, _OpenGroup] = {}
        self._answered = np.zeros(self._endpoint.num_slots, np.int64)  # bits, by slots

    def run(self) -> None:
        with ExitStack() as answering:
            while not self._endpoint.finished:
                wanted = self._endpoint.num_credits > 0 and not self._ended and self._has_room()
                if wanted:
                    answering.close()
                    self._send_group()
                    self._progressed_s = time.monotonic()  # however long the source took
                    answering.enter_context(self._session.statistics.timing("parity_cpu_s"))
                elif not self._ended:
                    self._pace.waits()
                self._connection.send(self._endpoint.bytes_to_send())
                if not wanted or self._connection.has_received():
                    self._take(self._endpoint.receive(self._connection.receive()))

    def _has_room(self) -> bool:
        """Tell whether another group may be open."""
        limiter = self._session.limiter
        most = None if limiter is None else limiter.max_open_groups
        return most is None or len(self._groups) < most

    def _take(self, events: Sequence[Event]) -> None:
        now_s = time.monotonic()
        if not events and now_s - self._progressed_s > MAX_STALL_S:
            raise FeedbackError(f"the other side is alive, but does nothing for {MAX_STALL_S:g} s")
        self._progressed_s = now_s if events else self._progressed_s
        for event in events:
            if isinstance(event, RequestTable):
                self._answer(event)
            elif isinstance(event, GopDone):
                group = self._groups.pop(event.number)
                if self._session.limiter is not None:
                    self._session.limiter.settle(event.number, int(self._answered[group.slots].sum()))
                self._pace.done(group.num_frames)
                self._progress(group.num_frames)

    def _send_group(self) -> None:
        group = next(self._source, None)
        if group is None:
            self._endpoint.send_end()
            self._ended = True
            return
        encoded = self._session.encode(group)
        with self._session.statistics.timing("writing_cpu_s"):
            number = self._endpoint.send_gop(encoded.record)
        first = self._endpoint.first_slot(number)
        for slot, frame in enumerate(encoded.frames, first):
            self._open.enter(slot, frame)
        slots = slice(first, first + len(encoded.frames))
        self._answered[slots] = 0
        self._groups[number] = _OpenGroup(encoded.record.num_frames, slots)
        self._pace.sent(encoded.record.num_frames)

    def _answer(self, requests: RequestTable) -> None:
        try:
            bits = self._open.answer(requests)
        except ValueError as err:  # no such plane in this frame: flow control knows only what they may have
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        self._endpoint.send_answers(bits)
        np.add.at(self._answered, requests.rows[:, SLOT], requests.rows[:, COUNT])
