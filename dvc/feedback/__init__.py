"""The feedback channel between encoder and decoder: see `docs/feedback.md`.

Messages and the two endpoints do no I/O; `dvc.feedback.transport` is the one module that moves bytes.
"""

from dvc.feedback.authentication import read_token
from dvc.feedback.endpoints import DecoderEndpoint, EncoderEndpoint, Event, ParityAnswer
from dvc.feedback.flow_control import MAX_OPEN_GOPS, max_open_gops
from dvc.feedback.link import Link, LinkCounts, dial, welcome
from dvc.feedback.messages import (
    PROTOCOL_VERSION,
    End,
    Failure,
    Gop,
    GopDone,
    Hello,
    NextGop,
)
from dvc.feedback.protection import Protection
from dvc.feedback.transport import DEFAULT_TIMEOUT_S, Connection, Listener, connect, listen, parse_address

__all__ = [
    "DEFAULT_TIMEOUT_S",
    "MAX_OPEN_GOPS",
    "PROTOCOL_VERSION",
    "Connection",
    "DecoderEndpoint",
    "EncoderEndpoint",
    "End",
    "Event",
    "Failure",
    "Gop",
    "GopDone",
    "Hello",
    "Link",
    "LinkCounts",
    "Listener",
    "NextGop",
    "ParityAnswer",
    "Protection",
    "connect",
    "dial",
    "listen",
    "max_open_gops",
    "parse_address",
    "read_token",
    "welcome",
]
