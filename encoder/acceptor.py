"""Acceptance of one decoder, and of the same one after its connection was lost."""

import queue
import selectors
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from dvc.config import CodecConfig
from dvc.errors import FeedbackError, RefusedError
from dvc.feedback import Connection, EncoderEndpoint, Hello, Listener, Protection
from dvc.files import Closing

HELLO_S = 5.0
"""Time from a connection to its whole hello, including TLS."""
MAX_GREETINGS = 64
"""Largest number of peers that have not said hello yet; beyond it the oldest is dropped."""
PAUSE_S = 0.02
"""Pause after each peer, which bounds the share of the processor that strangers take."""
MAX_LINES = 8
"""Number of rejected peers that are all logged; later on only as their number doubles."""


class AcceptedPeer(NamedTuple):
    """A connection to a decoder, and its endpoint."""

    connection: Connection
    endpoint: EncoderEndpoint


class PeerAcceptor(Closing):
    """Shakes hands with all peers in one thread, which never waits for any of them."""

    def __init__(
        self,
        listener: Listener,
        config: CodecConfig,
        protection: Protection,
        timeout_s: float,
        patience_s: float,
        log: Callable[[str], None],
    ) -> None:
        # first frame after some groups of pictures; None if a decoder cannot continue there
        self.first_frame: Callable[[int], int | None] = {0: 0}.get
        self._listener, self._config, self._protection = listener, config, protection
        self._timeout_s, self._patience_s, self._log = timeout_s, patience_s, log
        self._accepted: queue.SimpleQueue[AcceptedPeer] = queue.SimpleQueue()
        # deadlines of hellos and their peers by file descriptors, the oldest first
        self._greetings: dict[int, tuple[float, AcceptedPeer]] = {}
        self._decoder_id: bytes | None = None
        self._current: Connection | None = None
        self._num_rejected = 0
        self._closed = False
        self._woken, self._waking = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="acceptor", daemon=True)
        self._thread.start()

    def next_peer(self, within_s: float | None = None) -> AcceptedPeer | None:
        """Wait for a connection of the decoder; return None if there is none in time."""
        try:
            return self._accepted.get(timeout=within_s)
        except queue.Empty:
            return None

    def close(self) -> None:
        """Accept no more peers."""
        self._closed = True
        self._waking.close()
        self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        while not self._closed:
            deadline_s = min((deadline_s for deadline_s, _ in self._greetings.values()), default=None)
            left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
            for key, _ in self._selector.select(left_s):
                if key.fd in self._greetings:
                    self._greet(self._greetings[key.fd][1])
                elif key.fileobj is self._listener:
                    self._accept()
            for deadline_s, peer in [*self._greetings.values()]:
                if deadline_s <= time.monotonic():
                    self._reject(peer, f"no hello within {HELLO_S:g} s")
        for _, peer in self._greetings.values():
            peer.connection.close(0.0)
        self._selector.close()
        self._woken.close()

    def _accept(self) -> None:
        try:
            connection = self._listener.accept(self._protection, self._timeout_s)
        except BlockingIOError:
            return
        except (OSError, FeedbackError):  # too many open files, or the peer has gone
            max_greetings = 0
        else:
            peer, max_greetings = AcceptedPeer(connection, EncoderEndpoint(self._config)), MAX_GREETINGS
            self._greetings[connection.fileno()] = time.monotonic() + HELLO_S, peer
            self._selector.register(connection, selectors.EVENT_READ)
        if len(self._greetings) > max_greetings:
            self._reject(next(iter(self._greetings.values()))[1], "too many peers wait")
        time.sleep(PAUSE_S)

    def _greet(self, peer: AcceptedPeer) -> None:
        """Receive from a peer; accept or reject it once its hello is complete."""
        try:
            peer.endpoint.receive(peer.connection.receive(0.0))
            if peer.endpoint.hello is not None:
                self._admit(*peer, peer.endpoint.hello)
        except (FeedbackError, OSError) as err:
            self._reject(peer, str(err))

    def _admit(self, connection: Connection, endpoint: EncoderEndpoint, hello: Hello) -> None:
        if not self._protection.accepts(hello.token):
            raise RefusedError("the token is wrong")
        if self._decoder_id not in (None, hello.decoder_id):
            raise RefusedError("another decoder is served")
        first_frame = self.first_frame(hello.num_groups)
        if first_frame is None:
            raise RefusedError(f"no decoder can continue here after {hello.num_groups} groups of pictures")
        endpoint.send_welcome(first_frame)
        connection.send(endpoint.bytes_to_send(), within_s=0.0)
        if self._current is not None:
            self._current.break_off(f"the decoder has come back as {connection.name}")
        self._decoder_id, self._current = hello.decoder_id, connection
        self._forget(connection)
        self._accepted.put(AcceptedPeer(connection, endpoint))
        if not self._patience_s:
            self._closed = True
            self._listener.close()

    def _forget(self, connection: Connection) -> None:
        self._selector.unregister(connection)
        del self._greetings[connection.fileno()]

    def _reject(self, peer: AcceptedPeer, reason: str) -> None:
        """Close the connection of a peer that is not the decoder, after the reason."""
        connection, endpoint = peer
        self._forget(connection)
        endpoint.send_failure(reason)
        with suppress(FeedbackError):
            connection.send(endpoint.bytes_to_send(), within_s=0.0)
        connection.close(0.0)
        self._num_rejected += 1
        if self._num_rejected <= MAX_LINES or self._num_rejected.bit_count() == 1:
            text = f"not a decoder: {connection.name}: {reason}; still waiting"
            self._log(f"{text} ({self._num_rejected} rejected)" if self._num_rejected > MAX_LINES else text)
