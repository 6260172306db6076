"""The two ends of the feedback channel as state machines: bytes in, events out; no I/O, no clocks."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.bits import MAX_VARINT_BYTES, decode_varint
from dvc.config import CodecConfig, decode_config, encode_config
from dvc.errors import BitstreamError, FeedbackError, RefusedError
from dvc.feedback.flow_control import FlowControl, RequestAccount
from dvc.feedback.messages import (
    MAX_ANSWER_BITS,
    MAX_REQUEST_BYTES,
    PROTOCOL_VERSION,
    TYPES,
    End,
    Failure,
    Finished,
    Gop,
    GopDone,
    Hello,
    Message,
    NextGop,
    ParityAnswers,
    ParityRequests,
    Welcome,
    decode_payload,
    encode_message,
    max_payload_bytes,
)
from dvc.slepian_wolf import ParityRequest, RequestTable
from dvc.slepian_wolf.requests import RUN
from dvc.stream import GopRecord

_TLS_RECORDS = 0x15, 0x16
"""First bytes of TLS: alert and handshake."""


@dataclass(frozen=True, eq=False)
class ParityAnswer:
    """The bits of one request."""

    frame: int
    run: int
    bits: NDArray[np.uint8]  # shape (count,), each element 0 or 1


Event = Hello | Welcome | NextGop | Gop | RequestTable | ParityAnswer | GopDone | End
"""Result of a message of the peer."""


class _Endpoint(ABC):
    """Splits the bytes of the peer into messages, and collects messages for the peer."""

    _accepted: tuple[type[Message], ...]

    def __init__(self) -> None:
        self.config: CodecConfig  # the decoder has it from the welcome on, as both have the account
        self.flow: FlowControl
        self.finished = False  # whether both know that the decoder has written the whole sequence
        self._received = bytearray()
        self._outgoing: list[bytes] = []
        self._failed = False

    def receive(self, data: bytes) -> list[Event]:
        """Process bytes from the peer."""
        if self._failed:
            raise FeedbackError("the feedback channel has failed before")
        self._received += data
        events: list[Event] = []
        try:
            while (message := self._next_message()) is not None:
                if isinstance(message, Failure):
                    raise RefusedError(f"the other side ended the run: {message.text}")
                if isinstance(message, Hello | Welcome) and message.version != PROTOCOL_VERSION:
                    raise ValueError(
                        f"protocol version {message.version}; this program speaks version {PROTOCOL_VERSION}"
                    )
                events += self._accept(message)
        except (FeedbackError, BitstreamError, ValueError) as err:
            self._failed = True
            self._received.clear()
            if isinstance(err, FeedbackError):
                raise
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        return events

    def _next_message(self) -> Message | None:
        """Remove the next message from the received bytes; None if it is not complete."""
        received = self._received
        if not received:
            return None
        if not 1 <= received[0] <= len(TYPES):
            if received[0] in _TLS_RECORDS:
                raise BitstreamError("it uses TLS, which this side does not")
            raise BitstreamError(f"unknown message of type {received[0]}")
        message_type = TYPES[received[0] - 1]
        if message_type not in self._accepted:
            raise BitstreamError(f"unexpected {message_type.__name__}")
        length = received[1 : 1 + MAX_VARINT_BYTES]
        if len(length) < MAX_VARINT_BYTES and all(byte >= 0x80 for byte in length):
            return None
        size, start = decode_varint(received, 1)
        limit = max_payload_bytes(message_type, getattr(self, "config", None))
        if size > limit:
            raise BitstreamError(f"{message_type.__name__} of {size} bytes, at most {limit} are allowed")
        if len(received) < start + size:
            return None
        payload = bytes(received[start : start + size])
        del received[: start + size]
        try:
            return decode_payload(message_type, payload)
        except BitstreamError as err:
            raise BitstreamError(f"{message_type.__name__}: {err}") from err

    @abstractmethod
    def _accept(self, message: Message) -> Sequence[Event]:
        """Check a message of the peer against the state and update it; return the events."""

    def _finish(self) -> None:
        """Accept that the whole sequence is written."""
        if not self.flow.all_done:
            raise ValueError("Finished before all groups of pictures are done")
        self.finished, self._accepted = True, ()

    def _send(self, message: Message) -> None:
        self._outgoing.append(encode_message(message))

    def bytes_to_send(self) -> bytes:
        """Return the bytes that are to be sent to the peer, once."""
        data = b"".join(self._outgoing)
        self._outgoing.clear()
        return data

    def send_failure(self, text: str) -> None:
        """Report to the peer that this side ends the run."""
        self._send(Failure(text))


class EncoderEndpoint(_Endpoint):
    """The encoder's end of a connection: waits for the hello, sends groups of pictures, answers requests.

    Parameters
    ----------
    config : CodecConfig
        The codec configuration, which the decoder receives first.
    """

    _accepted: tuple[type[Message], ...] = (Hello,)

    def __init__(self, config: CodecConfig) -> None:
        super().__init__()
        self.config = config
        self.hello: Hello | None = None
        self._requests: RequestAccount  # large, so only of a decoder that is accepted

    def _accept(self, message: Message) -> Sequence[Event]:
        match message:
            case Hello():
                self.hello, self._accepted = message, ()
                return [message]
            case ParityRequests(table):
                self._requests.request(table)
                return [table]
            case NextGop():
                self.flow.add_credit()
                return [message]
            case GopDone(number):
                self.flow.close_gop(number)
                self._requests.close_gop(number)
                return [message]
            case Finished():
                self._finish()
                self._send(message)
        return []

    def send_welcome(self, first_frame: int = 0) -> None:
        """Accept the decoder, which continues with this frame after the groups that its hello names."""
        assert self.hello is not None
        self.flow = FlowControl(self.config, self.hello.num_groups, first_frame)
        self._requests = RequestAccount(self.config)
        self._accepted = (NextGop, ParityRequests, GopDone, Finished, Failure)
        self._send(Welcome(PROTOCOL_VERSION, encode_config(self.config)))

    def send_gop(self, record: GopRecord) -> tuple[int, int]:
        """Send the next group of pictures."""
        number, first_frame = self.flow.num_groups, self.flow.num_frames
        message = encode_message(Gop(number, record))
        if len(message) > max_payload_bytes(Gop, self.config):
            raise ValueError(f"`record` takes {len(message)} bytes, more than a message may have")
        self.flow.open_gop(number, record.num_frames, record.predicted)
        self._outgoing.append(message)
        return number, self._requests.open_gop(number, first_frame, record.num_frames - 1)

    def send_answers(self, packed: bytes) -> None:
        """Answer the first unanswered message of requests."""
        _check_size(self._requests.answer(), packed)
        self._send(ParityAnswers(packed))

    def send_end(self) -> None:
        """Announce that no more groups of pictures follow; requests may still come."""
        self.flow.end(self.flow.num_frames)
        self._send(End(self.flow.num_frames))


class DecoderEndpoint(_Endpoint):
    """The decoder's end of a connection: says hello, asks for groups of pictures and for parity.

    Parameters
    ----------
    decoder_id : bytes
        Random, the same for all connections of a run.
    num_groups, num_frames : int
        Groups of pictures and frames that the decoder has written.
    token : bytes
        Shared secret; empty without one.
    """

    _accepted: tuple[type[Message], ...] = (Welcome, Failure)

    def __init__(
        self, decoder_id: bytes, num_groups: int = 0, num_frames: int = 0, token: bytes = b""
    ) -> None:
        super().__init__()
        self.is_welcome = False  # whether the encoder has accepted the decoder
        self._first = num_groups, num_frames
        self._waiting: deque[RequestTable] = deque()
        self._send(Hello(PROTOCOL_VERSION, decoder_id, num_groups, token))

    def _accept(self, message: Message) -> Sequence[Event]:
        match message:
            case ParityAnswers(packed):
                if not self._waiting:
                    raise ValueError("bits that were not requested")
                table = self._waiting.popleft()
                _check_size(table, packed)
                if packed and packed[-1] & (1 << -table.num_bits % 8) - 1:
                    raise BitstreamError("the last byte is not padded with zeros")
                pairs = zip(table.rows[:, : RUN + 1].tolist(), table.divided(packed), strict=True)
                return [ParityAnswer(frame, run, bits) for (frame, run), bits in pairs]
            case Welcome(_, config):
                self.config = decode_config(config)
                self.flow, self.is_welcome = FlowControl(self.config, *self._first), True
                self._accepted = (Gop, ParityAnswers, End, Finished, Failure)
                return [message]
            case Gop(number, record):
                self.flow.open_gop(number, record.num_frames, record.predicted)
                return [message]
            case End(num_frames):
                self.flow.end(num_frames)
                self._send_finished()
                return [message]
            case Finished():
                self._finish()
        return []

    def send_next_gop(self) -> None:
        """Allow the encoder to send one more group of pictures; does nothing after the end."""
        if self.flow.ended:
            return
        self.flow.add_credit()
        self._send(NextGop())

    def send_requests(self, requests: Sequence[ParityRequest]) -> None:
        """Ask for bits of planes, in as few messages as possible."""
        for part in _parts(sorted(requests, key=lambda request: request.frame)):
            table = RequestTable.of(part)
            self._waiting.append(table)
            self._send(ParityRequests(table))

    def send_gop_done(self, number: int) -> None:
        """Report that a group of pictures is written, so that the encoder may discard it."""
        self.flow.close_gop(number)
        self._send(GopDone(number))
        self._send_finished()

    def _send_finished(self) -> None:
        """Report that the whole sequence is written, as soon as it is."""
        if self.flow.all_done:
            self._send(Finished())


def _parts(requests: Sequence[ParityRequest]) -> Iterator[list[ParityRequest]]:
    """Divide requests into messages."""
    part: list[ParityRequest] = []
    num_bits = num_bytes = 0
    for request in requests:
        begun = request.begun or ()
        num_numbers = 6 + len(request.positions) + sum(3 + len(part.planes) for part in begun)
        size = MAX_VARINT_BYTES * num_numbers + sum(len(part.areas) for part in begun)
        if part and (num_bits + request.count > MAX_ANSWER_BITS or num_bytes + size > MAX_REQUEST_BYTES):
            yield part
            part, num_bits, num_bytes = [], 0, 0
        part.append(request)
        num_bits, num_bytes = num_bits + request.count, num_bytes + size
    if part:
        yield part


def _check_size(table: RequestTable, packed: bytes) -> None:
    if len(packed) != -(-table.num_bits // 8):
        raise ValueError(f"{len(packed)} bytes of bits, asked for {table.num_bits} bits")
