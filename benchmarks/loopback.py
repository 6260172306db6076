"""Live runs between threads of one process."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import wait

from dvc.config import CodecConfig
from dvc.feedback import Connection, Listener, Protection, listen
from encoder.acceptor import AcceptedPeer, PeerAcceptor


@contextmanager
def accepting(
    config: CodecConfig,
    timeout_s: float,
    patience_s: float = 0.0,
    protection: Protection | None = None,
    log: "list[str] | None" = None,
) -> Iterator[tuple[Listener, PeerAcceptor]]:
    """Accept a decoder on a free port of this machine."""
    lines = [] if log is None else log
    with ExitStack() as stack:
        listener = stack.enter_context(listen("127.0.0.1"))
        acceptor = PeerAcceptor(
            listener, config, protection or Protection(), timeout_s, patience_s, lines.append
        )
        yield listener, stack.enter_context(acceptor)


def accepted(acceptor: PeerAcceptor) -> AcceptedPeer:
    """Wait for the decoder."""
    peer = acceptor.next_peer()
    assert peer is not None
    return peer


def accept_connection(listener: Listener, timeout_s: float) -> Connection:
    """Accept any peer, without a hello."""
    assert wait([listener], timeout_s)  # type: ignore[list-item]
    return listener.accept(Protection(), timeout_s)
