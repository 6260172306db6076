"""How a connection begins, by TLS, token and opening, and what follows, of which one sending is damaged."""

import contextlib
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.hostile.mutations import mutate
from dvc.errors import FeedbackError
from dvc.feedback import Protection
from dvc.feedback.opening import NEW, SESSION_BYTES, Opening, checks, open_stream, read_opening, refuse
from dvc.feedback.protected_socket import Peer, read_before
from dvc.feedback.resumable import Checks, ResumableStream
from dvc.feedback.tls import decoder_context, encoder_context

WITHIN_S = 0.3
"""Time for each part; where bytes are missing both ends wait for it."""
_TOKEN = b"a token of some length"
_SAID = b"from the decoder" * 40, b"from the encoder" * 90
_MOST_SENDINGS = 6
_READ_BYTES = 2**16


class _Damaging:
    """A socket of which one sending is damaged."""

    def __init__(self, peer: socket.socket, number: int, rng: np.random.Generator) -> None:
        self._peer, self._left, self._rng = peer, number, rng

    def sendall(self, data: bytes) -> None:
        self._peer.sendall(data if self._left else mutate(bytes(data), self._rng))
        self._left -= 1

    def send(self, data: bytes) -> int:
        self.sendall(data)
        return len(data)

    def __getattr__(self, name: str) -> object:
        return getattr(self._peer, name)


@cache
def _protections(with_tls: bool, with_token: bool) -> tuple[Protection, Protection]:
    """Return those of the decoder and of the encoder."""
    token = _TOKEN if with_token else None
    if not with_tls:
        return Protection(False, token), Protection(True, token)
    import trustme

    signing = trustme.CA(key_type=trustme.KeyType.ECDSA)
    with tempfile.TemporaryDirectory() as folder:
        chain, authorities = Path(folder) / "encoder.pem", Path(folder) / "authorities.pem"
        signing.issue_cert(
            "camera", key_type=trustme.KeyType.ECDSA
        ).private_key_and_cert_chain_pem.write_to_path(chain)
        signing.cert_pem.write_to_path(authorities)
        listening = Protection(True, token, encoder_context(chain))
        return Protection(False, token, decoder_context(authorities), "camera"), listening


def _decode(peer: Peer, refused: bool) -> bytes:
    """Begin as a decoder; return what the encoder says."""
    answer, both = open_stream(peer, Opening(NEW), WITHIN_S)
    return _talk(peer, answer, both, _SAID[0], len(_SAID[1]))


def _encode(peer: Peer, refused: bool) -> bytes:
    """Begin as an encoder; return what the decoder says."""
    asked = read_opening(peer, time.monotonic() + WITHIN_S)
    if refused:
        refuse(peer, "a decoder is connected already")
        return _SAID[0]
    answer = Opening(bytes(range(SESSION_BYTES)))
    peer.sendall(answer.encode())
    decoder, encoder = checks(asked, answer)
    return _talk(peer, asked, Checks(encoder, decoder), _SAID[1], len(_SAID[0]))


def _talk(peer: Peer, other: Opening, both: Checks, said: bytes, length: int) -> bytes:
    """Say something, and hear what the other side says."""
    stream, heard = ResumableStream(), b""
    stream.begin(other.num_received, both)
    for start in range(0, len(said), 300):
        stream.keep(said[start : start + 300])
        peer.sendall(stream.pieces())
    deadline_s = time.monotonic() + WITHIN_S
    while len(heard) < length:
        heard += stream.receive(read_before(deadline_s, peer, _READ_BYTES, "pieces"))
    return heard


def damaged_handshake(number: int) -> bytes:
    """Return the number: what is sent is drawn by both ends, so it is damaged on the way."""
    return str(number).encode()


def try_handshake(damaged: bytes) -> str:
    """Let two ends talk; each refuses, or hears what the other one has said."""
    number = int(damaged)
    rng = np.random.default_rng(number)
    protections = _protections(number % 4 >= 2, number % 2 == 1)
    sockets: list[socket.socket | _Damaging] = list(socket.socketpair())
    bad = int(rng.integers(2))
    sockets[bad] = _Damaging(sockets[bad], int(rng.integers(_MOST_SENDINGS)), rng)  # type: ignore[arg-type]
    refused, heard, failures = rng.random() < 0.1, [b"", b""], list[BaseException]()

    def _run(end: int, begin: Callable[[Peer, bool], bytes]) -> None:
        with contextlib.closing(sockets[end]) as peer:  # type: ignore[type-var]
            try:
                heard[end] = begin(protections[end].applied(peer, WITHIN_S), refused)  # type: ignore[arg-type]
            except (FeedbackError, OSError):
                heard[end] = b""
            except Exception as err:
                failures.append(err)

    other = threading.Thread(target=_run, args=(1, _encode))
    other.start()
    _run(0, _decode)
    other.join()
    if failures:
        raise failures[0]
    if any(said not in (b"", expected) for said, expected in zip(heard, reversed(_SAID), strict=True)):
        return "what is heard is not what was said"
    return "decoded" if all(heard) else "refused"
