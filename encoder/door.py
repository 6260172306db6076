"""Who is let in: one decoder, the same one after its connection was lost, another one while it is away."""

import hmac
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from dvc.config import CodecConfig
from dvc.errors import DvcError, FeedbackError
from dvc.feedback import Connection, EncoderEndpoint, Link, Listener, Protection, welcome
from dvc.feedback.opening import NEW, Opening, read_opening, refuse
from dvc.files import Closing

HELLO_S = 5.0
"""Time that a peer has to say hello; until then it may be anybody."""
MAX_GREETINGS = 8
"""Peers that are talked to at the same time until they have said hello; others wait."""
PAUSE_S = 0.02
"""Between two peers, so that strangers, however many, take a small share of the processor."""
MAX_TOLD = 5
"""Lines about strangers as they come; one more may be every `TOLD_APART_S`, others are counted."""
TOLD_APART_S = 10.0
NOTICING_S = 1.0
"""Time to notice that a decoder is gone in whose place another one wants to come."""

Entered = tuple[Link, EncoderEndpoint]


class Door(Closing):
    """Talks to whoever connects, beside the run, as long as it is open.

    `patience_s`: how long a decoder may be away. A run may go on with another decoder then, see `decoder`.
    """

    def __init__(
        self,
        listener: Listener,
        config: CodecConfig,
        protection: Protection,
        timeout_s: float,
        patience_s: float,
        say: Callable[[str], None],
    ) -> None:
        self._listener, self._config, self._protection = listener, config, protection
        self._timeout_s, self._patience_s, self._say = timeout_s, patience_s, say
        self._entered: queue.SimpleQueue[Entered] = queue.SimpleQueue()
        self._links: dict[bytes, Link] = {}  # of decoders that may come back, those that have entered last
        self._inside: Link | None = None
        self._lock = threading.Lock()
        self._lines_left, self._lines_since_s, self._num_untold = float(MAX_TOLD), time.monotonic(), 0
        self._room = threading.BoundedSemaphore(MAX_GREETINGS)
        self._closed = False
        threading.Thread(target=self._listen, name="door", daemon=True).start()

    def decoder(self) -> Entered:
        """Wait for a decoder; the next one may come when the link to the one before is superseded."""
        entered = self._entered.get()
        if not self._patience_s:
            self.close()
        return entered

    def close(self) -> None:
        """Let nobody in any more."""
        self._closed = True
        self._listener.close()

    def _listen(self) -> None:
        while not self._closed:
            self._room.acquire()
            try:
                connection = self._listener.accept(silence_timeout_s=self._timeout_s)
            except FeedbackError:  # closed, or no room for another connection
                self._room.release()
                time.sleep(0.05)
                continue
            threading.Thread(target=self._meet, args=(connection,), name="greeting", daemon=True).start()
            time.sleep(PAUSE_S)

    def _meet(self, connection: Connection) -> None:
        deadline_s = time.monotonic() + HELLO_S
        try:
            connection.protect(self._protection, HELLO_S)
            asked = connection.talk(lambda peer: read_opening(peer, deadline_s))
            if asked.session == NEW:
                self._let_in(connection, asked, deadline_s)
            else:
                self._bring_back(connection, asked)
        except DvcError as err:
            connection.close_within(0.0)
            if not self._closed:
                self._tell(err)
        finally:
            self._room.release()

    def _bring_back(self, connection: Connection, asked: Opening) -> None:
        """Let a decoder go on where its connection was lost."""
        with self._lock:
            links = list(self._links.items())
        link = next((link for name, link in links if hmac.compare_digest(name, asked.session)), None)
        try:
            if link is None:
                raise FeedbackError("another stream is served than the one that it had")
            link.resume(connection, asked)
        except FeedbackError as err:
            self._turn_away(connection, err)

    def _let_in(self, connection: Connection, asked: Opening, deadline_s: float) -> None:
        """Begin a stream with a decoder, if there is no other one."""
        inside = self._inside
        if inside is not None and not inside.wait_until_lost(NOTICING_S):
            self._turn_away(connection, FeedbackError("a decoder is connected already"))
        link = welcome(connection, asked, self._timeout_s, self._patience_s)
        link.keep_alive()
        with self._lock:
            self._links[link.session] = link
        try:
            endpoint = greet(link, self._config, deadline_s)
            with self._lock:
                inside, self._inside = self._inside, self._inside or link
                if inside is not None and inside.wait_until_lost(0.0):
                    del self._links[inside.session]
                    inside.supersede()
                    self._inside = link
                if self._inside is not link or self._closed:
                    raise FeedbackError("a decoder is connected already")
                self._entered.put((link, endpoint))
        except DvcError as err:
            with self._lock:
                self._links.pop(link.session, None)
            with suppress(FeedbackError):
                give_up(link, EncoderEndpoint(self._config), err)
            link.close()
            raise

    def _tell(self, err: DvcError) -> None:
        """Say that somebody was turned away, or count it where many are."""
        with self._lock:
            now_s = time.monotonic()
            earned = (now_s - self._lines_since_s) / TOLD_APART_S
            self._lines_left, self._lines_since_s = min(self._lines_left + earned, MAX_TOLD), now_s
            if self._lines_left < 1.0:
                self._num_untold += 1
                return
            self._lines_left -= 1.0
            others = f" ({self._num_untold} others since the last line)" if self._num_untold else ""
            self._num_untold = 0
        self._say(f"not a decoder: {err}; still waiting{others}")

    def _turn_away(self, connection: Connection, reason: FeedbackError) -> None:
        connection.talk(lambda peer: refuse(peer, str(reason)))
        connection.close()
        raise reason


def greet(link: Link, config: CodecConfig, deadline_s: float) -> EncoderEndpoint:
    """Wait for the hello of a decoder."""
    endpoint = EncoderEndpoint(config)
    while not endpoint.greeted:
        left_s = deadline_s - time.monotonic()
        if left_s <= 0.0:
            raise FeedbackError(f"the other side ({link.name}) says no hello for {HELLO_S:g} s")
        if link.wait(patient=True, at_most_s=left_s):
            endpoint.receive(link.receive())
    return endpoint


def give_up(link: Link, endpoint: EncoderEndpoint, reason: object) -> None:
    """Tell the other side that this side ends the run."""
    endpoint.send_failure(str(reason))
    link.send(endpoint.bytes_to_send())
