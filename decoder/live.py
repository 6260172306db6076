"""The decoder's end of a live run: groups of pictures and parity from an encoder behind a connection."""

from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.errors import FeedbackError
from dvc.feedback import Connection, DecoderEndpoint, End, Event, Gop, Hello, ParityAnswer
from dvc.turbo import ParityRequest

NUM_GROUPS_AHEAD = 2
"""Groups of pictures that the encoder may prepare before the decoder gets to them."""


class LiveSource:
    """Asks an encoder for groups of pictures and parity.

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
        self._connection = connection
        self._endpoint = DecoderEndpoint()
        self._events: deque[Event] = deque()
        if not isinstance(self._next_event(), Hello):
            raise FeedbackError("the encoder did not introduce itself")

    @property
    def config(self) -> CodecConfig:
        """Configuration of the sequence."""
        return self._endpoint.config

    def groups(self) -> Iterator[Gop]:
        """Ask for the groups of pictures, one after the other.

        Yields
        ------
        Gop
            Its Wyner-Ziv payloads are the headers of the frames; asking for the next one closes it.
        """
        for _ in range(NUM_GROUPS_AHEAD):
            self._endpoint.send_next_gop()
        ended = False
        while not ended:
            event = self._next_event()
            if isinstance(event, Gop):
                yield event
                self._endpoint.send_gop_done(event.number)
                if not any(isinstance(waiting, End) for waiting in self._events):
                    self._endpoint.send_next_gop()
            ended = isinstance(event, End)
        self._connection.send(self._endpoint.bytes_to_send())

    def answer(self, request: ParityRequest) -> NDArray[np.uint8]:
        """Ask for bits and wait for them.

        Parameters
        ----------
        request : ParityRequest
            Bits wanted.

        Returns
        -------
        ndarray of shape (count,), uint8
            The bits.
        """
        self._endpoint.send_request(request)
        while True:
            for event in self._events:
                if isinstance(event, ParityAnswer):
                    self._events.remove(event)
                    return event.bits
            self._receive()

    def _next_event(self) -> Event:
        while not self._events:
            self._receive()
        return self._events.popleft()

    def _receive(self) -> None:
        self._connection.send(self._endpoint.bytes_to_send())
        self._events.extend(self._endpoint.receive(self._connection.receive()))

    def give_up(self, reason: str) -> None:
        """Tell the encoder that the decoder cannot go on.

        Parameters
        ----------
        reason : str
            Why, in one line.
        """
        self._endpoint.send_failure(reason)
        self._connection.send(self._endpoint.bytes_to_send())
