"""The feedback channel between encoder and decoder: see `docs/spec/feedback.md`.

Messages and the two endpoints do no I/O; `dvc.feedback.transport` moves bytes.
"""

from dvc.feedback.endpoints import (
    DecoderEndpoint as DecoderEndpoint,
    EncoderEndpoint as EncoderEndpoint,
    Event as Event,
    ParityAnswer as ParityAnswer,
)
from dvc.feedback.flow_control import MAX_OPEN_GOPS as MAX_OPEN_GOPS, max_open_gops as max_open_gops
from dvc.feedback.messages import Failure as Failure, Gop as Gop, GopDone as GopDone, Hello as Hello
from dvc.feedback.protection import (
    Dialler as Dialler,
    Listener as Listener,
    Protection as Protection,
    listen as listen,
    parse_address as parse_address,
    read_token as read_token,
)
from dvc.feedback.transport import Connection as Connection, Readable as Readable
