"""The feedback channel between encoder and decoder: state machines without I/O; see `docs/feedback.md`.

`dvc.feedback.transport` is the one module that moves bytes; it is not imported here.
"""

from dvc.feedback.endpoints import DecoderEndpoint, EncoderEndpoint
from dvc.feedback.ledger import MAX_OPEN_GOPS
from dvc.feedback.messages import (
    PROTOCOL_VERSION,
    End,
    Event,
    Failure,
    Gop,
    GopDone,
    Hello,
    KeepAlive,
    NextGop,
    ParityAnswer,
    ParityRequest,
)

__all__ = [
    "MAX_OPEN_GOPS",
    "PROTOCOL_VERSION",
    "DecoderEndpoint",
    "EncoderEndpoint",
    "End",
    "Event",
    "Failure",
    "Gop",
    "GopDone",
    "Hello",
    "KeepAlive",
    "NextGop",
    "ParityAnswer",
    "ParityRequest",
]
