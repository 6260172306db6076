"""Links that do nothing by themselves: no signs of life, no second connection."""

import socket
import time

from dvc.feedback import DecoderEndpoint, EncoderEndpoint
from dvc.feedback.opening import NEW, Opening, checks, open_stream, read_opening
from dvc.feedback.resumable import Checks, ResumableStream

PATIENCE_S = 120.0


class RawLink:
    """One end of a link on a socket that is connected."""

    def __init__(self, peer: socket.socket, begin: Checks) -> None:
        self.peer = peer
        self.stream = ResumableStream()
        self.stream.begin(0, begin)

    @classmethod
    def of_decoder(cls, peer: socket.socket) -> "RawLink":
        """Begin a stream with an encoder."""
        _, begin = open_stream(peer, Opening(NEW), PATIENCE_S)
        peer.settimeout(PATIENCE_S)
        return cls(peer, begin)

    @classmethod
    def of_encoder(cls, peer: socket.socket) -> "RawLink":
        """Begin a stream with a decoder."""
        asked, answer = read_opening(peer, time.monotonic() + PATIENCE_S), Opening(bytes(range(16)))
        peer.sendall(answer.encode())
        peer.settimeout(PATIENCE_S)
        return cls(peer, Checks(*checks(asked, answer)[::-1]))

    def send(self, data: bytes) -> None:
        """Send bytes."""
        self.stream.keep(data)
        while pieces := self.stream.pieces():
            self.peer.sendall(pieces)

    def event(self, endpoint: DecoderEndpoint | EncoderEndpoint) -> object:
        """Return the next event at an endpoint; one at a time is all that is provoked."""
        while True:
            raw = self.peer.recv(2**16)
            assert raw
            events = endpoint.receive(self.stream.receive(raw))
            if events:
                return events[0]
