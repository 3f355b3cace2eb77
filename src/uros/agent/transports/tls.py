"""TLS over TCP at the agent's end.

A handshake costs the one thread of the agent milliseconds, and memory before the client is known.
So there are at most :data:`MAX_HANDSHAKES` at once, they take no more than :data:`SHARE` of the
time, and if several wait, the network that has used the least time goes first, so that a flood from
one machine does not block others.
"""

from __future__ import annotations

import errno
import hashlib
import socket
import ssl
from collections import Counter
from typing import Any, Final
from urllib.parse import quote

from ...token_bucket import TokenBucket
from ..log import RateLimit
from .base import INFO, WARNING, Host, TransportError
from .certificates import Certificates
from .tcp import TcpServer

# The longest time of a handshake, which may stop half-way. A board computes for some seconds.
HANDSHAKE_SECONDS: Final = 10.0
# The most handshakes at a time, because each takes tens of kilobytes.
MAX_HANDSHAKES: Final = 256
# The most of the thread's time that handshakes may take, as a fraction, and how much of what was
# not used may be saved up, in seconds. Clients may start handshakes without pause.
SHARE: Final = 0.25
_SAVED: Final = 0.25
# How long handshakes wait when the time is used up, in seconds.
_PAUSE: Final = 0.05
_SWEEP_SECONDS: Final = 1.0
# A kind of fault is logged so many times at once, then once in so many seconds.
FAULT_BURST: Final = 4
FAULT_SECONDS: Final = 60.0
# How many networks' shares are remembered.
_REMEMBERED: Final = 4096
# The most characters of a client's name; only names of hosts may be longer in X.509.
_MAX_CN: Final = 64
# The dates of the files are checked so often, in seconds.
_DAY: Final = 86_400.0
_BEGINNING: Final = b"\x16\x03"
_WANTS: Final = (ssl.SSLWantReadError, ssl.SSLWantWriteError)


class _Channel(ssl.SSLSocket):
    """Raises BlockingIOError as a plain socket does, and closes TLS properly."""

    def recv(self, buflen: int = 1024, flags: int = 0) -> bytes:
        try:
            return self.read(buflen)
        except _WANTS:
            raise BlockingIOError from None

    def send(self, data: Any, flags: int = 0) -> int:
        try:
            return super().send(data)
        except _WANTS:
            raise BlockingIOError from None

    def close(self) -> None:
        """Close the TLS session, if that is possible without blocking, and the socket."""
        try:
            self.unwrap()
        except (OSError, ValueError):
            pass
        super().close()


class TlsServer(TcpServer):
    """A :class:`TcpServer` whose clients speak TLS 1.2 or later.

    With a CA, each client must show a certificate that the CA signed; its name is appended to the
    client's address: ``192.0.2.7:50123 (CN=left)``.
    """

    def __init__(self, port: int, host: str, certificates: Certificates) -> None:
        super().__init__(port, host)
        self.name = self.name.replace("TCP", "TLS")
        self._certificates = certificates
        self._context = certificates.context()
        self._names: dict[Any, str] = {}  # by connection with TLS; "" without a certificate
        self._shown: dict[Any, str] = {}  # certificates of clients that showed one
        self._shaking: dict[Any, float] = {}  # start of handshakes, the oldest first
        self._waiting: set[Any] = set()  # those of them that wait for time
        self._spent: dict[str, float] = {}  # seconds, by network
        self._time_limit = TokenBucket(_SAVED, SHARE)
        self._looking = False  # whether a check for slow handshakes is scheduled
        self._faults = RateLimit(FAULT_SECONDS, FAULT_BURST)

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        super().open(host)
        self._time_limit.available(host.clock.monotonic())
        self._faults = RateLimit(FAULT_SECONDS, FAULT_BURST, host.clock.monotonic)
        files = self._certificates
        admitted = (
            f"with a certificate of {files.ca}" if files.ca else "anybody (--tls-ca restricts)"
        )
        host.note(
            INFO,
            self.name,
            "tls",
            "TLS 1.2 or later",
            f"certificate: {files.cert}, clients: {admitted}",
        )
        self._note_doubts()

        host.wake_at(_DAY, self._check_daily)

    def _check_daily(self) -> None:
        self._note_doubts()
        self._host.wake_at(_DAY, self._check_daily)

    def _note_doubts(self) -> None:
        for doubt in self.doubts(self._host.clock.time_ns() / 1e9):
            self._host.note(WARNING, self.name, "tls", "boards may not connect", doubt)

    def doubts(self, now: float) -> list[str]:
        """Return what will keep boards from connecting, today or soon."""
        return self._certificates.doubts(now)

    def admits_boards(self, now: float) -> bool:
        """Return whether the dates of its files let any board connect."""
        return self._certificates.admits_boards(now)

    def troubles(self, now: float) -> list[str]:
        """Return which files are not valid now, and why new ones are refused."""
        return self._certificates.troubles(now)

    def not_after(self) -> dict[str, float]:
        """Return when each of its files ends, by the file's option."""
        return self._certificates.not_after()

    def reload(self) -> None:
        """Use the certificates, the CA and the revocation list that the files have now."""
        try:
            self._certificates.reload()
        except TransportError as error:
            self._tell("cannot use new files", f"{error.strerror}; the former ones stay in use")
            return
        self._context = self._certificates.context()
        files = self._certificates
        authority = f", CA: {files.ca}" if files.ca else ""
        revocations = f", revocation list: {files.crl}" if files.crl else ""
        about = f"certificate: {files.cert}{authority}{revocations}"
        self._host.note(INFO, self.name, "tls", "certificates loaded", about)
        self._note_doubts()
        self._close_revoked()

    def _close_revoked(self) -> None:
        """Close connections of clients whose certificates were revoked meanwhile."""
        for connection in list(self._shown):
            der = connection.sock.getpeercert(binary_form=True)
            if der and self._certificates.is_revoked(der):
                self._fault(connection, _REVOKED)

    # --- handshakes ---------------------------------------------------------------------

    def _ready(self, connection: Any) -> None:
        if connection in self._names:
            super()._ready(connection)
            self._look_behind(connection)
        elif connection in self._connections and connection not in self._waiting:
            self._shake(connection)

    def _look_behind(self, connection: Any) -> None:
        """Handle bytes that OpenSSL has decrypted already, which the selector does not see."""
        if connection in self._connections and connection.sock.pending():
            self._host.wake_at(0.0, lambda: self._ready(connection))

    def _shake(self, connection: Any) -> None:
        """Do one step of a handshake, if there is time for it."""
        if connection not in self._shaking and not self._admitted(connection):
            return
        if self._seconds_left(self._host.clock.monotonic()) <= 0.0 or self._waiting:
            self._host.unwatch(connection.sock.fileno())
            if not self._waiting:
                self._host.wake_at(_PAUSE, self._resume)
            self._waiting.add(connection)
            return
        self._step(connection)

    def _seconds_left(self, now: float) -> float:
        """Return the seconds that handshakes may take now."""
        seconds = self._time_limit.available(now)
        if seconds >= _SAVED or len(self._spent) > _REMEMBERED:
            self._spent.clear()  # there is time for all: earlier use does not matter any more
        return seconds

    def _resume(self) -> None:
        """Continue waiting handshakes, the network with the least time used first."""
        now = self._host.clock.monotonic()
        while self._waiting and self._seconds_left(now) > 0.0:
            connection = min(
                self._waiting,
                key=lambda waiting: (self._spent.get(waiting.network, 0.0), self._shaking[waiting]),
            )
            self._waiting.discard(connection)
            self._step(connection)
        if self._waiting:
            self._host.wake_at(_PAUSE, self._resume)

    def _admitted(self, connection: Any) -> bool:
        """Return whether this can be a handshake; other connections are closed."""
        try:
            first = connection.sock.recv(2, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            first = b""
        if not first:
            self._drop(connection)
            return False
        if first != _BEGINNING[: len(first)]:
            self._fault(
                connection, "it does not use TLS, which this port requires: give the board's"
                " program a TlsTransport (docs/security.md), or serve plain TCP on another port",
            )  # fmt: skip
            return False
        if len(self._shaking) >= MAX_HANDSHAKES and not self._make_room(connection):
            self._fault(connection, f"over {MAX_HANDSHAKES} handshakes at once: it may try again")
            return False
        self._shaking[connection] = self._host.clock.monotonic()
        if not self._looking:
            self._looking = True
            self._host.wake_at(_SWEEP_SECONDS, self._look)
        return True

    def _make_room(self, connection: Any) -> bool:
        """Drop the oldest handshake of the network that has the most, if it is another network."""
        shares = Counter(each.network for each in self._shaking)
        network, most = shares.most_common(1)[0]
        if shares[connection.network] + 1 >= most:
            return False
        oldest = next(each for each in self._shaking if each.network == network)
        self._fault(oldest, f"over {MAX_HANDSHAKES} handshakes at once, most from this address")
        return True

    def _look(self) -> None:
        """Drop handshakes that take too long."""
        expired_before = self._host.clock.monotonic() - HANDSHAKE_SECONDS
        slow = [
            connection for connection, since in self._shaking.items() if since <= expired_before
        ]
        for connection in slow:
            self._fault(
                connection, f"no handshake within {HANDSHAKE_SECONDS:.0f} s: the line is slow, or"
                " it does not use TLS",
            )  # fmt: skip
        self._looking = bool(self._shaking)
        if self._looking:
            self._host.wake_at(_SWEEP_SECONDS, self._look)

    def _step(self, connection: Any) -> None:
        before = self._host.clock.thread_time()
        try:
            done = self._go_on(connection)
        finally:
            took = self._host.clock.thread_time() - before
            self._time_limit.spend(took)
            self._spent[connection.network] = self._spent.get(connection.network, 0.0) + took
        if done:
            del self._shaking[connection]
            self._names[connection] = _name_in(connection.sock.getpeercert())
            shown = connection.sock.getpeercert(binary_form=True)
            if shown:
                self._shown[connection] = hashlib.sha256(shown).hexdigest()
            self._watch(connection, False)
            self._ready(connection)

    def _go_on(self, connection: Any) -> bool:
        """Continue a handshake; return whether it is complete."""
        try:
            if not isinstance(connection.sock, _Channel) and not self._wrap(connection):
                return False
            connection.sock.do_handshake()
        except ssl.SSLWantReadError:
            self._watch(connection, False)
            return False
        except ssl.SSLWantWriteError:
            self._watch(connection, True)
            return False
        except (OSError, ValueError) as error:
            self._fault(connection, self._why(error))
            return False
        return True

    def _why(self, error: Exception) -> str:
        """Explain a failed handshake, with the remedy."""
        if getattr(error, "reason", None) == _EXPIRED:
            for doubt in self.doubts(self._host.clock.time_ns() / 1e9):
                if doubt.startswith("--tls-cert") and " expired on " in doubt:
                    return f"it refuses the agent's certificate: {doubt}"
        return _explain(error)

    def _watch(self, connection: Any, writing: bool) -> None:
        self._host.watch(connection.sock.fileno(), lambda: self._ready(connection), writing)

    def _wrap(self, connection: Any) -> bool:
        try:
            context = self._certificates.context()
        except TransportError as error:
            self._tell("cannot use new files", f"{error.strerror}; the former ones stay in use")
            context = self._certificates.context()
        if context is not self._context:
            self._context = context
            self._close_revoked()
        context.sslsocket_class = _Channel
        plain = connection.sock
        # A socket that cannot be wrapped is closed by that, and its descriptor may be reused.
        self._host.unwatch(plain.fileno())
        try:
            connection.sock = context.wrap_socket(
                plain, server_side=True, do_handshake_on_connect=False
            )
        except (OSError, ValueError) as error:
            if plain.fileno() < 0:
                connection.sock = socket.socket()  # for _drop to close
            self._fault(connection, self._why(error))
            return False
        return True

    # --- faults ---------------------------------------------------------------------------

    def _fault(self, connection: Any, why: str) -> None:
        """Log a fault of a connection, and drop it."""
        address = self.address(connection)
        self.on_refused("tls", address, why)
        self._tell("no TLS connection", why, f"address: {address}, ")
        self._drop(connection)

    def _tell(self, event: str, why: str, where: str = "") -> None:
        times = self._faults.times(why)
        if times is not None:
            self._host.note(WARNING, self.name, "tls", event, f"{where}{why}{times}")

    def _drop(self, connection: Any) -> None:
        self._shaking.pop(connection, None)
        self._waiting.discard(connection)
        super()._drop(connection)
        self._names.pop(connection, None)
        self._shown.pop(connection, None)

    def label(self) -> str:
        """Return what it listens on, as text."""
        return f"{super().label()}, TLS"

    def address(self, peer: Any) -> str:
        """Return the peer as text."""
        name = self._names.get(peer)
        return f"{super().address(peer)} (CN={name})" if name else super().address(peer)

    def certificate_of(self, peer: Any) -> str | None:
        """Return the SHA-256 of the peer's certificate in hex; None without one."""
        return self._shown.get(peer)


def _name_in(certificate: Any) -> str:
    """Return the name in a certificate; "" without a certificate.

    Characters other than ``A-Z a-z 0-9 _ . - ~ @`` and space are percent-encoded (RFC 3986), so
    that no two names look alike. Rules may match a name, so one that is cut ends with a hash.
    """
    if not certificate:
        return ""
    names = [value for part in certificate.get("subject", ()) for key, value in part
             if key == "commonName"]  # fmt: skip
    names += [value for kind, value in certificate.get("subjectAltName", ()) if kind == "DNS"]
    if not names:
        return "?"
    name = names[0]
    if len(name) > _MAX_CN:
        name = f"{name[: _MAX_CN - 17]}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"
    return quote(name, safe=" @")


def _explain(error: Exception) -> str:
    """Explain a failed handshake, with the remedy."""
    reason = str(getattr(error, "reason", None) or "")
    words = reason.replace("_", " ").lower() or str(error)
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_message in _REFUSED:
            return _REFUSED[error.verify_message]
        return (
            f"its certificate is refused ({error.verify_message}): give the board one that the CA"
            " of --tls-ca has signed, and that is valid today"
        )
    if reason == "PEER_DID_NOT_RETURN_A_CERTIFICATE":
        return "it shows no certificate, which --tls-ca demands: give its program cert and key"
    if "ALERT" in reason and ("CERTIFICATE" in reason or reason.endswith("_CA")):
        return (
            f"it refuses the agent's certificate ({words}): give the board the CA that has signed"
            " it, and check the name that it connects to and its clock"
        )
    if reason in _OLD:
        return f"it has no TLS 1.2 or later, or no cipher of today ({words}): update its TLS"
    if isinstance(error, (ConnectionError, ssl.SSLEOFError, ssl.SSLZeroReturnError)):
        return (
            "it closed the connection during the handshake; if it does so again, check"
            " what it says about the agent's certificate"
        )
    return f"the handshake fails ({words}): what it sends is not valid TLS"


# What a board says of a certificate of the agent whose time is over.
_EXPIRED: Final = "SSLV3_ALERT_CERTIFICATE_EXPIRED"
_REVOKED: Final = (
    "its certificate is revoked by --tls-crl: give the board a new one, if it is yours"
)
# What OpenSSL says of a client's certificate, and what it means here.
_REFUSED: Final = {
    "certificate has expired": "its certificate has expired: give the board a new one",
    "certificate is not yet valid":
        "its certificate is not valid yet: check this machine's clock, or give the board a new one",
    "certificate revoked": _REVOKED,
    "CRL has expired":
        "the revocation list of --tls-crl has ended, so no board is admitted: make a new one",
    "unable to get certificate CRL":
        "--tls-crl has no list of the CA that signed its certificate: append that CA's list",
}  # fmt: skip
_OLD: Final = (
    "UNSUPPORTED_PROTOCOL", "NO_SHARED_CIPHER", "NO_SHARED_SIGNATURE_ALGORITHMS",
    "NO_SUITABLE_SIGNATURE_ALGORITHM", "NO_SUITABLE_KEY_SHARE", "VERSION_TOO_LOW",
    "WRONG_SSL_VERSION",
)  # fmt: skip


def tls_server(
    port: int, host: str, cert: str | None, key: str | None, ca: str | None, crl: str | None = None
) -> TlsServer:
    """Make the server for the four options; raises TransportError."""
    for option, path in (("--tls-cert", cert), ("--tls-key", key)):
        if path is None:
            raise TransportError(
                errno.EINVAL, f"{option} is missing: TLS needs --tls-cert FILE and --tls-key FILE;"
                " docs/security.md has the commands that make them",
            )  # fmt: skip
    assert cert is not None and key is not None
    return TlsServer(port, host, Certificates(cert, key, ca, crl))
