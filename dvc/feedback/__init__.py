"""The feedback channel between encoder and decoder: see `docs/spec/feedback.md`.

Messages and the two endpoints do no I/O; `dvc.feedback.transport` moves bytes.
"""

from dvc.feedback.endpoints import DecoderEndpoint, EncoderEndpoint, Event, ParityAnswer
from dvc.feedback.flow_control import MAX_OPEN_GOPS, max_open_gops
from dvc.feedback.messages import PROTOCOL_VERSION, End, Failure, Gop, GopDone, Hello, NextGop, Welcome
from dvc.feedback.protection import Dialler, Listener, Protection, listen, parse_address, read_token
from dvc.feedback.transport import DEFAULT_TIMEOUT_S, Connection, Readable

__all__ = [
    "DEFAULT_TIMEOUT_S",
    "MAX_OPEN_GOPS",
    "PROTOCOL_VERSION",
    "Connection",
    "DecoderEndpoint",
    "Dialler",
    "EncoderEndpoint",
    "End",
    "Event",
    "Failure",
    "Gop",
    "GopDone",
    "Hello",
    "Listener",
    "NextGop",
    "ParityAnswer",
    "Protection",
    "Readable",
    "Welcome",
    "listen",
    "max_open_gops",
    "parse_address",
    "read_token",
]
