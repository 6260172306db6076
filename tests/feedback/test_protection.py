"""Protection of connections by TLS and a token."""

import hashlib
import ssl
import threading
from pathlib import Path
from typing import NamedTuple

import pytest

from benchmarks.loopback import accept_connection
from dvc.errors import ConfigError, ConnectionLostError, FeedbackError, UntrustedError
from dvc.feedback import Connection, Dialler, Protection, listen, read_token
from dvc.feedback.protection import decoder_context, encoder_context, parse_fingerprint

TOKEN = b"correct horse battery"


class Certificates(NamedTuple):
    """Files of an encoder on this machine, and the fingerprint of its certificate."""

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


def serve_once(
    encoder: Protection, decoder: Protection, said: bytes = b"hello", host: str = "127.0.0.1"
) -> tuple[list[bytes | Exception], list[bytes | Exception]]:
    """Connect; the decoder says something, which the encoder returns; return what each end got."""
    near: list[bytes | Exception] = []
    far: list[bytes | Exception] = []

    def _encode(connection: Connection) -> None:
        received = b""
        try:
            while len(received) < len(said):
                if not (data := connection.receive(5.0)):
                    break
                received += data
            near.append(received)
            connection.send(received)
        except FeedbackError as err:
            near.append(err)
        connection.close()

    with listen("127.0.0.1") as listener:
        dialler = Dialler(host, listener.port, decoder, 5.0)

        def _accept() -> None:
            connection = accept_connection(listener, 5.0)
            _encode(Connection(encoder.wrap(connection._socket), 5.0))

        thread = threading.Thread(target=_accept)
        thread.start()
        try:
            with dialler.connect(5.0) as connection:
                connection.send(said)
                received = b""
                while len(received) < len(said):
                    received += connection.receive(5.0)
                far.append(received)
        except FeedbackError as err:
            far.append(err)
        thread.join()
    return near, far


@pytest.mark.parametrize("trust", ["authority", "fingerprint", "both"])
def test_a_trusted_encoder_is_talked_to(trust: str, certificates: Certificates) -> None:
    tls = decoder_context(None if trust == "fingerprint" else certificates.authority)
    fingerprint = None if trust == "authority" else certificates.fingerprint
    said = bytes(range(256)) * 4000
    near, far = serve_once(
        Protection(encoder_context(certificates.chain), TOKEN), Protection(tls, TOKEN, fingerprint), said
    )
    assert near == far == [said]


def test_another_certificate_is_not_trusted(certificates: Certificates) -> None:
    """By authority, by name, or by fingerprint; and nothing, so no token, is sent to it."""
    import trustme

    stranger = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trustme.CA().configure_trust(stranger)
    encoder = Protection(encoder_context(certificates.chain))
    for reason, decoder, host in (
        ("unable to get local issuer certificate", Protection(stranger), "127.0.0.1"),
        ("mismatch", Protection(decoder_context(certificates.authority)), "localhost"),
        ("another fingerprint", Protection(decoder_context(None), b"", bytes(32)), "127.0.0.1"),
    ):
        near, far = serve_once(encoder, decoder, host=host)
        assert isinstance(far[0], UntrustedError)
        assert reason in str(far[0])
        assert not isinstance(near[0], bytes)


def test_a_peer_without_tls_is_refused(certificates: Certificates) -> None:
    tls = Protection(encoder_context(certificates.chain))
    near, _ = serve_once(tls, Protection())
    assert isinstance(near[0], ConnectionLostError)
    assert "sent no valid TLS" in str(near[0])
    known = Protection(decoder_context(None), b"", certificates.fingerprint)
    _, far = serve_once(Protection(), known, said=b"x")
    assert isinstance(far[0], UntrustedError)
    assert "no TLS with the other side" in str(far[0])


def test_certificates_and_fingerprints_are_checked(certificates: Certificates, tmp_path: Path) -> None:
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


def test_a_token_is_only_sent_inside_tls(certificates: Certificates) -> None:
    """Without TLS it is refused; with it, the encoder accepts the same token and no other."""
    with pytest.raises(ConfigError, match="--token-file requires TLS"):
        Protection(None, TOKEN)
    encoder = Protection(encoder_context(certificates.chain), TOKEN)
    assert encoder.accepts(TOKEN)
    for wrong in (b"", TOKEN[:-1], TOKEN + b"x", TOKEN.upper()):
        assert not encoder.accepts(wrong)
    assert not Protection().accepts(TOKEN)


@pytest.mark.parametrize("size", [0, 15, 16, 4096, 4097])
def test_tokens_are_read_or_refused(size: int, tmp_path: Path) -> None:
    """By their size, without white space around them; in one line that names the file."""
    path, token = tmp_path / "token", b"x" * size
    path.write_bytes(token if size >= 4096 else b" \n" + token + b"\n")
    if 16 <= size <= 4096:
        assert read_token(path) == token
        return
    with pytest.raises(ConfigError, match="token: a token has from 16 to 4096 bytes"):
        read_token(path)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "fe80::1%eth0", "2001:db8::1"])
def test_a_network_needs_protection(host: str, certificates: Certificates) -> None:
    """Unless the user allows plain TCP; only programs of this machine get at loopback."""
    for loopback in ("127.0.0.1", "127.8.0.1", "::1"):
        Protection().check_exposure(loopback)
    with pytest.raises(ConfigError, match="TLS or --insecure is required"):
        Protection().check_exposure(host)
    for enough in (Protection(encoder_context(certificates.chain)), Protection(insecure=True)):
        enough.check_exposure(host)
