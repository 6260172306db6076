"""The two ends of the feedback channel as state machines: bytes in, events out; no I/O, no clocks."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.bits import MAX_VARINT_BYTES, decode_varint
from dvc.config import CodecConfig, decode_config, encode_config
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback.flow_control import FlowControl
from dvc.feedback.messages import (
    MAX_ANSWER_BITS,
    MAX_REQUEST_BYTES,
    PROTOCOL_VERSION,
    TYPES,
    End,
    Failure,
    Gop,
    GopDone,
    Hello,
    Message,
    NextGop,
    ParityAnswers,
    ParityRequests,
    decode_payload,
    encode_message,
    max_payload_bytes,
)
from dvc.slepian_wolf import ParityRequest, RequestTable
from dvc.slepian_wolf.requests import RUN
from dvc.stream import GopRecord


@dataclass(frozen=True, eq=False)
class ParityAnswer:
    """The bits that a request wanted."""

    frame: int
    run: int
    bits: NDArray[np.uint8]  # shape (count,), each element 0 or 1


Event = Hello | NextGop | Gop | RequestTable | ParityAnswer | GopDone | End
"""What has come of the peer."""


class _Endpoint(ABC):
    """Cuts the bytes of the peer into messages, and collects those for the peer."""

    _accepted: tuple[type[Message], ...]
    _config: CodecConfig | None = None

    def __init__(self) -> None:
        self._received = bytearray()
        self._outgoing: list[bytes] = []
        self._failed = False
        self._limits: dict[type[Message], int] = {}

    def receive(self, data: bytes) -> list[Event]:
        """Take in bytes from the peer."""
        if self._failed:
            raise FeedbackError("the feedback channel has failed before")
        self._received += data
        events: list[Event] = []
        try:
            while (message := self._next_message()) is not None:
                if isinstance(message, Failure):
                    raise FeedbackError(f"the other side gave up: {message.text}")
                events += self._accept(message)
        except (BitstreamError, ValueError) as err:
            self._fail()
            raise FeedbackError(f"the other side broke the feedback protocol: {err}") from err
        except FeedbackError:
            self._fail()
            raise
        return events

    def _fail(self) -> None:
        self._failed = True
        self._received.clear()

    def _next_message(self) -> Message | None:
        """Take the next message off the bytes received, None if it is not complete."""
        received = self._received
        if not received:
            return None
        if not 1 <= received[0] <= len(TYPES):
            raise BitstreamError(f"unknown message of type {received[0]}")
        message_type = TYPES[received[0] - 1]
        if message_type not in self._accepted:
            raise BitstreamError(f"unexpected {message_type.__name__}")
        length = received[1 : 1 + MAX_VARINT_BYTES]
        if len(length) < MAX_VARINT_BYTES and all(byte >= 0x80 for byte in length):
            return None
        size, start = decode_varint(received, 1)
        limit = self._max_payload_bytes(message_type)
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

    def _max_payload_bytes(self, message_type: type[Message]) -> int:
        if message_type not in self._limits:
            self._limits[message_type] = max_payload_bytes(message_type, self._config)
        return self._limits[message_type]

    @abstractmethod
    def _accept(self, message: Message) -> Sequence[Event]:
        """Check a message of the peer against the state, bring that up to date, and say what has come."""

    def _send(self, message: Message) -> None:
        self._outgoing.append(encode_message(message))

    def bytes_to_send(self) -> bytes:
        """Return what is to be sent to the peer, once."""
        data = b"".join(self._outgoing)
        self._outgoing.clear()
        return data

    def send_failure(self, text: str) -> None:
        """Tell the peer that this side gives up."""
        self._send(Failure(text))


class EncoderEndpoint(_Endpoint):
    """The encoder's end: waits for a decoder's hello, sends groups of pictures and answers requests.

    Parameters
    ----------
    config : CodecConfig
        The codec configuration; it is the first thing that the decoder gets.
    """

    _accepted: tuple[type[Message], ...] = (Hello,)

    def __init__(self, config: CodecConfig) -> None:
        super().__init__()
        self.greeted = False
        self.first_frame = 0  # of the sequence, with which this decoder begins
        self._config = config
        self._flow = FlowControl(config)
        self._owes_hello = False

    @property
    def num_credits(self) -> int:
        """Number of groups of pictures that the decoder waits for."""
        return self._flow.num_credits

    @property
    def finished(self) -> bool:
        """Whether the end was sent and the decoder is done with all groups of pictures."""
        return self._flow.finished

    def _accept(self, message: Message) -> Sequence[Event]:
        match message:
            case Hello(version, config, first_frame):
                _check_version(version)
                if config or first_frame:
                    raise ValueError("bytes follow the version")
                self.greeted = True
                self._accepted = (NextGop, ParityRequests, GopDone, Failure)
                self._owes_hello = True
                return [message]
            case ParityRequests(table):
                self._flow.request(table, in_turn=True)
                return [table]
            case NextGop():
                self._flow.add_credit()
                return [message]
            case GopDone(number):
                self._flow.close_gop(number)
                return [message]
        return []

    def bytes_to_send(self) -> bytes:
        """Return what is to be sent to the peer, once; first of all, which frame is the first."""
        hello, self._owes_hello = self._owes_hello, False
        said = b""
        if hello and self._config is not None:
            said = encode_message(Hello(PROTOCOL_VERSION, encode_config(self._config), self.first_frame))
        return said + super().bytes_to_send()

    def send_gop(self, record: GopRecord) -> int:
        """Send the next group of pictures.

        Parameters
        ----------
        record : GopRecord
            Its Wyner-Ziv payloads hold what the decoder needs before its first request, not the parity.

        Returns
        -------
        int
            Number of the group of pictures.

        Raises
        ------
        ValueError
            If the decoder has not asked for one, the number of frames does not fit the configuration, or the
            record is too large for a message.
        """
        number = self._flow.num_gops
        message = encode_message(Gop(number, record))
        if len(message) > max_payload_bytes(Gop, self._config):
            raise ValueError(f"`record` takes {len(message)} bytes, more than a message may have")
        self._flow.open_gop(number, record.num_frames, record.predicted)
        self._outgoing.append(message)
        return number

    def first_slot(self, number: int) -> int:
        """Return where the first frame of an open group of pictures is held; other frames follow.

        Parameters
        ----------
        number : int
            Number of the group.

        Returns
        -------
        int
            Number of its slot.
        """
        return self._flow.first_slot(number)

    @property
    def num_slots(self) -> int:
        """Most frames that may be open."""
        return self._flow.num_slots

    def send_answers(self, packed: bytes) -> None:
        """Answer the first of all requests that wait.

        Parameters
        ----------
        packed : bytes
            Bits for each request of the table, one after the other, filled up to a byte with zeros.

        Raises
        ------
        ValueError
            If nothing was asked for, or not so many bits.
        """
        _check_size(self._flow.answer(), packed)
        self._send(ParityAnswers(packed))

    def send_end(self) -> None:
        """Say that there are no more groups of pictures; requests may still come.

        Raises
        ------
        ValueError
            If it was said before.
        """
        self._flow.end(self._flow.num_frames)
        self._send(End(self._flow.num_frames))


class DecoderEndpoint(_Endpoint):
    """The decoder's end: says hello, asks for groups of pictures and for parity."""

    _accepted: tuple[type[Message], ...] = (Hello, Failure)

    def __init__(self) -> None:
        super().__init__()
        self.first_frame = 0  # of the sequence, with which this decoder begins
        self._opened: FlowControl | None = None  # with the encoder's Hello
        self._send(Hello(PROTOCOL_VERSION))

    @property
    def config(self) -> CodecConfig:
        """The codec configuration.

        Raises
        ------
        ValueError
            If `Hello` has not come yet.
        """
        if self._config is None:
            raise ValueError("Hello has not come yet")
        return self._config

    @property
    def num_credits(self) -> int:
        """Number of groups of pictures that were asked for and have not come."""
        return self._flow.num_credits

    @property
    def finished(self) -> bool:
        """Whether the end has come and all groups of pictures are done."""
        return self._opened is not None and self._opened.finished

    @property
    def _flow(self) -> FlowControl:
        if self._opened is None:
            raise ValueError("Hello has not come yet")
        return self._opened

    def _accept(self, message: Message) -> Sequence[Event]:
        match message:
            case ParityAnswers(packed):
                return _divided(self._flow.answer(), packed)
            case Hello(version, config, first_frame):
                self._accept_hello(version, config)
                self.first_frame = first_frame
                return [message]
            case Gop(number, record):
                self._flow.open_gop(number, record.num_frames, record.predicted)
                return [message]
            case End(num_frames):
                self._flow.end(num_frames)
                return [message]
        return []

    def _accept_hello(self, version: int, config: bytes) -> None:
        _check_version(version)
        self._config = decode_config(config)
        self._opened = FlowControl(self._config)
        self._accepted = (Gop, ParityAnswers, End, Failure)

    def send_next_gop(self) -> None:
        """Allow the encoder to send one more group of pictures; does nothing once the end has come.

        Raises
        ------
        ValueError
            If `Hello` has not come yet, or as many are open or asked for as may be: `max_open_gops`.
        """
        if self._flow.ended:
            return
        self._flow.add_credit()
        self._send(NextGop())

    def send_requests(self, requests: Sequence[ParityRequest]) -> None:
        """Ask for bits of planes, in as few messages as may be.

        Parameters
        ----------
        requests : sequence of ParityRequest
            For runs without a request that waits for its answer; bits are asked for in order, each once.

        Raises
        ------
        ValueError
            If no such bits can be asked for now.
        """
        for part in _parts(sorted(requests, key=lambda request: request.frame)):
            table = RequestTable.of(part)
            self._flow.request(table)
            self._send(ParityRequests(table))

    def send_gop_done(self, number: int) -> None:
        """Let the encoder forget a group of pictures.

        Parameters
        ----------
        number : int
            Its number.

        Raises
        ------
        ValueError
            If it is not open, or answers are missing.
        """
        self._flow.close_gop(number)
        self._send(GopDone(number))


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


def _check_version(version: int) -> None:
    if version != PROTOCOL_VERSION:
        raise ValueError(f"protocol version {version}; this program speaks version {PROTOCOL_VERSION}")


def _check_size(table: RequestTable, packed: bytes) -> None:
    if len(packed) != -(-table.num_bits // 8):
        raise ValueError(f"{len(packed)} bytes of bits, asked for {table.num_bits} bits")


def _divided(table: RequestTable, packed: bytes) -> list[Event]:
    """Return the answer to each request."""
    _check_size(table, packed)
    if packed and packed[-1] & (1 << -table.num_bits % 8) - 1:
        raise BitstreamError("the last byte is not filled up with zeros")
    places = table.rows[:, : RUN + 1].tolist()
    return [
        ParityAnswer(frame, run, own) for (frame, run), own in zip(places, table.divided(packed), strict=True)
    ]
