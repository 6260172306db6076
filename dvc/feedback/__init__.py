"""The feedback channel between encoder and decoder: see `docs/spec/feedback.md`.

Messages and the two endpoints do no I/O; `dvc.feedback.transport` moves bytes.
"""

from dvc.feedback.endpoints import DecoderEndpoint, EncoderEndpoint, Event, ParityAnswer
from dvc.feedback.flow_control import MAX_OPEN_GOPS, max_open_gops
from dvc.feedback.messages import Failure, Gop, GopDone, Hello
from dvc.feedback.protection import Dialler, Listener, Protection, listen, parse_address, read_token
from dvc.feedback.transport import Connection, Readable

__all__ = [
    "MAX_OPEN_GOPS",
    "Connection",
    "DecoderEndpoint",
    "Dialler",
    "EncoderEndpoint",
    "Event",
    "Failure",
    "Gop",
    "GopDone",
    "Hello",
    "Listener",
    "ParityAnswer",
    "Protection",
    "Readable",
    "listen",
    "max_open_gops",
    "parse_address",
    "read_token",
]
