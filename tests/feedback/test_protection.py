"""Protection of connections: TLS, tokens, both; whom a decoder believes, and where a network needs any."""

import hashlib
import socket
import ssl
import threading
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import ConfigError, FeedbackError
from dvc.feedback import Connection, Protection, connect, listen
from dvc.feedback.authentication import GREETING
from dvc.feedback.tls import decoder_context, encoder_context, parse_fingerprint

TOKEN = b"correct horse battery"


class Certificates(NamedTuple):
    """Files of an encoder on this machine, and what a decoder may know of it."""

    authority: Path
    chain: Path  # with its key
    fingerprint: bytes


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    """Make certificates."""
    import trustme

    folder = tmp_path_factory.mktemp("certificates")
    authority, chain = folder / "authority.pem", folder / "chain.pem"
    signing = trustme.CA()
    signed = signing.issue_cert("127.0.0.1")
    signing.cert_pem.write_to_path(authority)
    signed.private_key_and_cert_chain_pem.write_to_path(chain)
    der = ssl.PEM_cert_to_DER_cert(signed.cert_chain_pems[0].bytes().decode())
    return Certificates(authority, chain, hashlib.sha256(der).digest())


class Ends(NamedTuple):
    """What came of an attempt to connect: the ends, or why not."""

    near: Connection
    far: Connection
    errors: list[str]


def protected(encoder: Protection, decoder: Protection) -> Ends:
    """Connect, and protect both ends."""
    errors: list[str] = []
    with listen("127.0.0.1") as listener:
        far = connect(listener.host, listener.port, 5.0)
        near = listener.accept(5.0, 5.0)

    def protect(connection: Connection, protection: Protection) -> None:
        try:
            connection.protect(protection, 2.0)
        except FeedbackError as err:
            errors.append(str(err))

    thread = threading.Thread(target=protect, args=(far, decoder))
    thread.start()
    protect(near, encoder)
    thread.join()
    return Ends(near, far, errors)


@pytest.mark.parametrize("token", [None, TOKEN], ids=["TLS", "TLS and token"])
@pytest.mark.parametrize("belief", ["authority", "fingerprint"])
def test_both_directions_are_used_at_once(
    belief: str, token: bytes | None, certificates: Certificates
) -> None:
    """By threads of their own, with more data than any piece holds, all of which arrive."""
    known: dict[str, Any] = {"tls": decoder_context(None), "fingerprint": certificates.fingerprint}
    if belief == "authority":
        known = {"tls": decoder_context(certificates.authority), "host": "127.0.0.1"}
    encoder = Protection(True, token, encoder_context(certificates.chain))
    near, far, errors = protected(encoder, Protection(False, token, **known))
    assert errors == []
    data = bytes(range(256)) * 40000
    got: dict[str, bytes] = {"near": b"", "far": b""}

    def collect(name: str, connection: Connection) -> None:
        while len(got[name]) < len(data):
            got[name] += connection.receive()

    with near, far:
        work = [
            threading.Thread(target=near.send, args=(data,)),
            threading.Thread(target=far.send, args=(data,)),
            threading.Thread(target=collect, args=("near", near)),
            threading.Thread(target=collect, args=("far", far)),
        ]
        for thread in work:
            thread.start()
        for thread in work:
            thread.join()
        assert got == {"near": data, "far": data}
        assert not near.pending


def test_what_is_sent_is_hidden(certificates: Certificates) -> None:
    """Bytes on the way are not those that are sent."""
    passed: list[bytes] = []

    class Tapped(socket.socket):
        def sendall(self, data: bytes, flags: int = 0) -> None:  # type: ignore[override]
            passed.append(bytes(data))
            super().sendall(data, flags)

    near, far = socket.socketpair()
    tapped = Tapped(fileno=near.detach())
    with tapped, far:
        known = Protection(False, None, decoder_context(None), None, certificates.fingerprint)
        thread = threading.Thread(target=lambda: known.applied(far, 5.0))
        thread.start()
        encoder = Protection(True, None, encoder_context(certificates.chain)).applied(tapped, 5.0)
        thread.join()
        encoder.sendall(b"a secret picture")
    assert b"secret" not in b"".join(passed)


def test_another_certificate_is_not_believed(certificates: Certificates) -> None:
    """By authority, by name, or by fingerprint."""
    import trustme

    encoder = Protection(True, None, encoder_context(certificates.chain))
    stranger = trustme.CA()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    stranger.configure_trust(context)
    beliefs = {
        "unable to get local issuer certificate": Protection(False, None, context, "127.0.0.1"),
        "mismatch": Protection(False, None, decoder_context(certificates.authority), "example.org"),
        "another fingerprint": Protection(False, None, decoder_context(None), None, bytes(32)),
    }
    for reason, decoder in beliefs.items():
        near, far, errors = protected(encoder, decoder)
        with near, far:
            assert any(reason in error for error in errors), errors


def test_who_speaks_no_tls_is_turned_away(certificates: Certificates) -> None:
    """In one line, at either end."""
    tls = Protection(True, None, encoder_context(certificates.chain))
    near, far, errors = protected(tls, Protection(False, TOKEN))
    with near, far:
        assert any("no TLS with the other side" in error for error in errors), errors
    near, far, errors = protected(
        Protection(True, TOKEN),
        Protection(False, None, decoder_context(None), None, certificates.fingerprint),
    )
    with near, far:
        assert any("has no token" in error for error in errors), errors


def test_what_was_changed_on_the_way_shows(certificates: Certificates) -> None:
    """Every bit of an encrypted piece counts."""
    near, far = socket.socketpair()
    with near, far:
        known = Protection(False, None, decoder_context(None), None, certificates.fingerprint)
        found: list[Any] = []
        thread = threading.Thread(target=lambda: found.append(known.applied(far, 5.0)))
        thread.start()
        Protection(True, None, encoder_context(certificates.chain)).applied(near, 5.0)
        thread.join()
        near.sendall(b"\x17\x03\x03\x00\x20" + bytes(32))
        near.shutdown(socket.SHUT_WR)
        with pytest.raises(FeedbackError, match="changed on the way"):
            found[0].recv(100)


def test_certificates_and_fingerprints_are_checked(certificates: Certificates, tmp_path: Path) -> None:
    """Files that hold none are refused in one line."""
    nothing = tmp_path / "nothing.pem"
    nothing.write_text("nothing")
    for make in (encoder_context, decoder_context):
        with pytest.raises(ConfigError, match=r"nothing\.pem"):
            make(nothing)
    with pytest.raises(ConfigError, match=r"authority\.pem"):
        encoder_context(certificates.authority)  # has no key
    shown = certificates.fingerprint.hex(":").upper()
    assert parse_fingerprint(shown) == certificates.fingerprint
    assert parse_fingerprint(f"sha256 Fingerprint={shown}\n") == certificates.fingerprint
    for text in ("", "12:34", "g" * 64):
        with pytest.raises(ConfigError, match="64 hexadecimal digits"):
            parse_fingerprint(text)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.0.1", "::1"])
def test_loopback_needs_no_protection(host: str) -> None:
    """Nobody else gets there."""
    Protection(True).check_exposure(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "fe80::1%eth0", "2001:db8::1"])
def test_a_network_needs_protection(host: str, certificates: Certificates) -> None:
    """Or that the user says otherwise."""
    with pytest.raises(ConfigError, match="--token-file"):
        Protection(True).check_exposure(host)
    for enough in (
        Protection(True, TOKEN),
        Protection(True, None, encoder_context(certificates.chain)),
        Protection(True, insecure=True),
    ):
        enough.check_exposure(host)


@settings(max_examples=60)
@given(words=st.binary(max_size=300), prefix=st.sampled_from(["", "token", "tls"]))
def test_whatever_a_stranger_says_it_is_turned_away(
    words: bytes, prefix: str, certificates: Certificates
) -> None:
    """Also behind the beginning of a greeting, or of a TLS record."""
    begins = {"": b"", "token": GREETING, "tls": b"\x16\x03\x01\x00\x40\x01\x00\x00\x3c\x03\x03"}
    for encoder in (Protection(True, TOKEN), Protection(True, None, encoder_context(certificates.chain))):
        near, far = socket.socketpair()
        with near, far:
            far.sendall(begins[prefix] + words)
            far.shutdown(socket.SHUT_WR)
            with pytest.raises(FeedbackError):
                encoder.applied(near, 2.0)
