"""How a connection is protected: by TLS, by a token, by both, or not at all."""

import ssl
import time
from dataclasses import dataclass
from ipaddress import ip_address

from dvc.errors import ConfigError
from dvc.feedback.authentication import authenticate
from dvc.feedback.protected_socket import Peer
from dvc.feedback.tls import TlsSocket


@dataclass(frozen=True)
class Protection:
    """What both ends of a connection do before anything else is said.

    Attributes
    ----------
    listening : bool
        Whether this is the end that listens.
    token : bytes or None
        What both ends know, see `read_token`.
    tls : SSLContext or None
        What this end proves itself with, or believes.
    host : str or None
        Whom the certificate must be for, where it is believed because of who signed it.
    fingerprint : bytes or None
        SHA-256 of the certificate that must be that of the other end.
    insecure : bool
        Whether anybody may be talked to through a network.
    """

    listening: bool
    token: bytes | None = None
    tls: ssl.SSLContext | None = None
    host: str | None = None
    fingerprint: bytes | None = None
    insecure: bool = False

    @property
    def is_none(self) -> bool:
        """Whether anybody may talk."""
        return self.token is None and self.tls is None

    def check_exposure(self, host: str) -> None:
        """Refuse to talk to anybody through a network, unless that is wanted; `host`: numerical address."""
        if self.is_none and not self.insecure and not ip_address(host.partition("%")[0]).is_loopback:
            raise ConfigError(
                f"{host} is on a network, where anybody may talk: --token-file, TLS or --insecure is needed"
            )

    def applied(self, peer: Peer, within_s: float) -> Peer:
        """Return what is to be used in place of a socket that is just connected."""
        deadline_s = time.monotonic() + within_s
        if self.tls is not None:
            protected = TlsSocket(peer, self.tls, self.listening, self.host)
            protected.shake_hands(within_s, self.fingerprint)
            peer = protected
        if self.token is not None:
            left_s = max(deadline_s - time.monotonic(), 0.0)
            peer = authenticate(peer, self.token, self.listening, left_s)
        return peer
