"""Handshakes with a damaged chunk: plain or by TLS, with or without a token."""

import socket
import tempfile
import threading
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.hostile.mutations import mutate
from dvc.config import VideoConfig, codec_config
from dvc.errors import ConfigError, FeedbackError
from dvc.feedback import Connection, DecoderEndpoint, EncoderEndpoint, Protection
from dvc.feedback.protection import decoder_context, encoder_context

WITHIN_S = 0.3
"""Time for each step; if bytes are missing both ends wait for it."""
_TOKEN = b"a token of some length"
_MAX_CHUNKS = 5
_READ_BYTES = 2**16
_CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")


@cache
def _protections(with_tls: bool, with_token: bool) -> tuple[Protection, Protection]:
    """Return the protections of the decoder and of the encoder."""
    if not with_tls:
        return Protection(), Protection()
    import trustme

    token = _TOKEN if with_token else b""
    authority = trustme.CA(key_type=trustme.KeyType.ECDSA)
    with tempfile.TemporaryDirectory() as folder:
        chain, authorities = Path(folder) / "encoder.pem", Path(folder) / "authorities.pem"
        certificate = authority.issue_cert("camera", key_type=trustme.KeyType.ECDSA)
        certificate.private_key_and_cert_chain_pem.write_to_path(chain)
        authority.cert_pem.write_to_path(authorities)
        return Protection(decoder_context(authorities), token), Protection(encoder_context(chain), token)


def _pair() -> tuple[socket.socket, socket.socket]:
    """Return two TCP sockets that are connected to each other."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        return near, server.accept()[0]


def _pump(source: socket.socket, target: socket.socket, bad: int, rng: np.random.Generator) -> None:
    """Relay bytes, and damage one chunk."""
    number = 0
    try:
        while data := source.recv(_READ_BYTES):
            target.sendall(mutate(data, rng) if number == bad else data)
            number += 1
        target.shutdown(socket.SHUT_WR)
    except OSError:
        pass


def _decode(peer: socket.socket, protection: Protection) -> str:
    """Begin as a decoder."""
    wrapped = protection.wrap(peer, "camera")
    with Connection(wrapped, WITHIN_S) as connection:
        connection.shake_hands(WITHIN_S)
        protection.check_certificate(wrapped)
        endpoint = DecoderEndpoint(bytes(16), token=protection.token)
        connection.send(endpoint.bytes_to_send())
        while not endpoint.is_welcome:
            if not (data := connection.receive(WITHIN_S)):
                raise FeedbackError("no welcome")
            endpoint.receive(data)
    return "welcome"


def _encode(peer: socket.socket, protection: Protection, ended: list[object]) -> None:
    """Begin as an encoder."""
    try:
        with Connection(protection.wrap(peer), WITHIN_S) as connection:
            endpoint = EncoderEndpoint(_CONFIG)
            while endpoint.hello is None:
                if not (data := connection.receive(WITHIN_S)):
                    raise FeedbackError("no hello")
                endpoint.receive(data)
            if not protection.accepts(endpoint.hello.token):
                raise FeedbackError("the token is wrong")
            endpoint.send_welcome()
            connection.send(endpoint.bytes_to_send())
            connection.receive(WITHIN_S)
    except FeedbackError:
        ended.append("refused")
    except Exception as err:
        ended.append(err)


def damaged_handshake(number: int) -> bytes:
    """Return the number: both ends draw random bytes, so these are damaged on the way."""
    return str(number).encode()


def try_handshake(damaged: bytes) -> str:
    """Connect two ends; each refuses, or the decoder is welcome."""
    number = int(damaged)
    rng = np.random.default_rng(number)
    decoder, encoder = _protections(number % 4 >= 2, number % 2 == 1)
    (near, first), (second, far) = _pair(), _pair()
    bad, chunk, ended = int(rng.integers(2)), int(rng.integers(_MAX_CHUNKS)), list[object]()
    threads = [
        threading.Thread(target=_pump, args=(first, second, -1 if bad else chunk, rng)),
        threading.Thread(target=_pump, args=(second, first, chunk if bad else -1, rng)),
        threading.Thread(target=_encode, args=(far, encoder, ended)),
    ]
    with near, first, second, far:
        for thread in threads:
            thread.start()
        try:
            outcome = _decode(near, decoder)
        except (FeedbackError, ConfigError):
            outcome = "refused"
        for pumped in (first, second):
            with suppress(OSError):
                pumped.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()
    if ended and isinstance(ended[0], Exception):
        raise ended[0]
    return "decoded" if outcome == "welcome" else outcome
