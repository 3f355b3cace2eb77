"""TCP in TLS at the agent's end: a handshake first, and all that TCP does behind it.

A handshake costs the one thread of the agent milliseconds, and memory before anybody has said
who he is. So there are as many at once as :data:`MAX_HANDSHAKES` says, they take no more than
:data:`SHARE` of the time, and where more want to come, those go first whose network has had the
least: a flood from one machine does not keep the others out.
"""

from __future__ import annotations

import errno
import hashlib
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Final
from urllib.parse import quote

from ..log import RateLimit
from ..policy.token_bucket import TokenBucket
from .base import INFO, WARNING, Host, TransportError
from .certificates import Certificates
from .ip import text_of
from .tcp import TcpServer

# Attack: handshakes that stop half-way. A board's own arithmetic takes some seconds.
HANDSHAKE_SECONDS: Final = 10.0
# Attack: many of them, tens of kilobytes each.
MAX_HANDSHAKES: Final = 256
# Attack: handshakes as fast as they go. How much of the thread's time they may take, and how much
# of what was not used may be saved up, in seconds.
SHARE: Final = 0.25
_SAVED: Final = 0.25
# How long those wait that come when the time is used up.
_PAUSE: Final = 0.05
_SWEEP_SECONDS: Final = 1.0
# A kind of fault is logged so many times at once, then once in so many seconds.
FAULT_BURST: Final = 4
FAULT_SECONDS: Final = 60.0
# How many networks' shares are remembered.
_REMEMBERED: Final = 4096
# Of a client's name; X.509 has no longer ones, but for those of hosts.
_MAX_CN: Final = 64
_BEGINNING: Final = b"\x16\x03"
_WANTS: Final = (ssl.SSLWantReadError, ssl.SSLWantWriteError)


class _Channel(ssl.SSLSocket):
    """Says "not now" and "good-bye" as a plain socket does."""

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
        """With a farewell, where one can be said without waiting."""
        try:
            self.unwrap()
        except (OSError, ValueError):
            pass
        super().close()


class TlsServer(TcpServer):
    """A :class:`TcpServer` whose clients speak TLS 1.2 or later.

    Where the certificates have a CA, each client has one that it has signed; the name in that
    stands behind the client's address: ``192.0.2.7:50123 (CN=left)``.
    """

    def __init__(
        self, port: int, host: str, certificates: Certificates,
        clock: Callable[[], float] = time.monotonic,
        cpu: Callable[[], float] = time.thread_time,
    ) -> None:  # fmt: skip
        super().__init__(port, host)
        self.name = self.name.replace("TCP", "TLS")
        self._certificates = certificates
        self._clock = clock
        self._cpu = cpu
        self._names: dict[Any, str] = {}  # of those who are through; "": without a certificate
        self._shown: dict[Any, str] = {}  # the certificates of those who have shown one
        self._shaking: dict[Any, float] = {}  # since when, the oldest first
        self._waiting: set[Any] = set()  # those of them whose time has not come
        self._spent: dict[str, float] = {}  # seconds, by network
        self._time_limit = TokenBucket(_SAVED, SHARE)
        self._time_limit.available(clock())
        self._looking = False  # whether a look at those who take long is due
        self._faults = RateLimit(FAULT_SECONDS, FAULT_BURST, clock)

    def open(self, host: Host) -> None:
        super().open(host)
        files = self._certificates
        who = f"with a certificate of {files.ca}" if files.ca else "anybody (--tls-ca restricts)"
        host.note(
            INFO, self.name, "tls", "TLS 1.2 or later", f"certificate: {files.cert}, clients: {who}"
        )
        doubt = files.doubt()
        if doubt:
            host.note(
                WARNING, self.name, "tls", "boards will not trust this agent",
                f"{files.cert}: {doubt}; make a new one (docs/security.md)",
            )  # fmt: skip

    # --- handshakes ---------------------------------------------------------------------

    def _ready(self, connection: Any) -> None:
        if connection in self._names:
            super()._ready(connection)
            self._look_behind(connection)
        elif connection in self._connections and connection not in self._waiting:
            self._shake(connection)

    def _look_behind(self, connection: Any) -> None:
        """The selector does not see what OpenSSL has decrypted already."""
        if connection in self._connections and connection.sock.pending():
            self._host.wake_at(0.0, lambda: self._ready(connection))

    def _shake(self, connection: Any) -> None:
        """One step of a handshake, when its time has come."""
        if connection not in self._shaking and not self._admitted(connection):
            return
        if self._seconds_left(self._clock()) <= 0.0 or self._waiting:
            self._host.unwatch(connection.sock.fileno())
            if not self._waiting:
                self._host.wake_at(_PAUSE, self._resume)
            self._waiting.add(connection)
            return
        self._step(connection)

    def _seconds_left(self, now: float) -> float:
        """Return the seconds that handshakes may take now."""
        left = self._time_limit.available(now)
        if left >= _SAVED or len(self._spent) > _REMEMBERED:
            self._spent.clear()  # there is time for all, whoever had how much before
        return left

    def _resume(self) -> None:
        """Those who wait, the network first that has had the least."""
        now = self._clock()
        while self._waiting and self._seconds_left(now) > 0.0:
            connection = min(
                self._waiting,
                key=lambda it: (self._spent.get(it.network, 0.0), self._shaking[it]),
            )
            self._waiting.discard(connection)
            self._step(connection)
        if self._waiting:
            self._host.wake_at(_PAUSE, self._resume)

    def _admitted(self, connection: Any) -> bool:
        """Whether this may be the beginning of a handshake; what cannot be is dropped."""
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
                connection, "it speaks no TLS, which this port requires: give the board's program a"
                " TlsTransport (docs/security.md), or serve plain TCP on another port",
            )  # fmt: skip
            return False
        if len(self._shaking) >= MAX_HANDSHAKES and not self._make_room(connection):
            self._fault(connection, f"over {MAX_HANDSHAKES} handshakes at once: it may try again")
            return False
        self._shaking[connection] = self._clock()
        if not self._looking:
            self._looking = True
            self._host.wake_at(_SWEEP_SECONDS, self._look)
        return True

    def _make_room(self, newcomer: Any) -> bool:
        """Drop the oldest of the network that has the most, if that is not the newcomer's."""
        shares = Counter(it.network for it in self._shaking)
        network, most = shares.most_common(1)[0]
        if shares[newcomer.network] + 1 >= most:
            return False
        oldest = next(it for it in self._shaking if it.network == network)
        self._fault(oldest, f"over {MAX_HANDSHAKES} handshakes at once, most from this address")
        return True

    def _look(self) -> None:
        """Drop those who take too long."""
        late = self._clock() - HANDSHAKE_SECONDS
        for connection in [it for it, since in self._shaking.items() if since <= late]:
            self._fault(
                connection, f"no handshake within {HANDSHAKE_SECONDS:.0f} s: the line is slow, or"
                " it does not speak TLS",
            )  # fmt: skip
        self._looking = bool(self._shaking)
        if self._looking:
            self._host.wake_at(_SWEEP_SECONDS, self._look)

    def _step(self, connection: Any) -> None:
        before = self._cpu()
        try:
            done = self._go_on(connection)
        finally:
            took = self._cpu() - before
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
        """Whether the handshake is done now."""
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
            self._fault(connection, _explain(error))
            return False
        return True

    def _watch(self, connection: Any, writing: bool) -> None:
        self._host.watch(connection.sock.fileno(), lambda: self._ready(connection), writing)

    def _wrap(self, connection: Any) -> bool:
        try:
            context = self._certificates.context()
        except TransportError as error:
            self._tell("cannot use new files", f"{error.strerror}; the former ones stay in use")
            context = self._certificates.context()
        context.sslsocket_class = _Channel
        plain = connection.sock
        # What cannot be wrapped is closed on the way, and its number may be another's then.
        self._host.unwatch(plain.fileno())
        try:
            connection.sock = context.wrap_socket(
                plain, server_side=True, do_handshake_on_connect=False
            )
        except (OSError, ValueError) as error:
            if plain.fileno() < 0:
                connection.sock = socket.socket()  # for _drop to close
            self._fault(connection, _explain(error))
            return False
        return True

    # --- faults ---------------------------------------------------------------------------

    def _fault(self, connection: Any, why: str) -> None:
        """Say so, and drop it."""
        self._tell("no TLS connection", why, f"address: {text_of(connection.address)}, ")
        self._drop(connection)

    def _tell(self, what: str, why: str, where: str = "") -> None:
        times = self._faults.times(why)
        if times is not None:
            self._host.note(WARNING, self.name, "tls", what, f"{where}{why}{times}")

    def _drop(self, connection: Any) -> None:
        self._shaking.pop(connection, None)
        self._waiting.discard(connection)
        super()._drop(connection)
        self._names.pop(connection, None)
        self._shown.pop(connection, None)

    def label(self) -> str:
        return f"{super().label()}, TLS"

    def address(self, peer: Any) -> str:
        name = self._names.get(peer)
        return f"{super().address(peer)} (CN={name})" if name else super().address(peer)

    def certificate_of(self, peer: Any) -> str | None:
        return self._shown.get(peer)


def _name_in(certificate: Any) -> str:
    """Whose certificate it is, or nothing. What is not in ``A-Z a-z 0-9 _ . - ~ @`` or a space is
    percent-encoded (RFC 3986), so that no name looks like another.

    Rules may be for a name, so one that is cut ends with what tells it from others.
    """
    if not certificate:
        return ""
    found = [value for part in certificate.get("subject", ()) for key, value in part
             if key == "commonName"]  # fmt: skip
    found += [value for kind, value in certificate.get("subjectAltName", ()) if kind == "DNS"]
    if not found:
        return "?"
    name = found[0]
    if len(name) > _MAX_CN:
        name = f"{name[: _MAX_CN - 17]}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"
    return quote(name, safe=" @")


def _explain(error: Exception) -> str:
    """What is the matter with a handshake, and what to do."""
    reason = str(getattr(error, "reason", None) or "")
    words = reason.replace("_", " ").lower() or str(error)
    if isinstance(error, ssl.SSLCertVerificationError):
        return (
            f"its certificate is refused ({error.verify_message}): give the board one that the CA"
            " of --tls-ca has signed, and that is valid today"
        )
    if reason == "PEER_DID_NOT_RETURN_A_CERTIFICATE":
        return "it shows no certificate, which --tls-ca demands: give its program cert and key"
    if "ALERT" in reason and ("CERTIFICATE" in reason or reason.endswith("_CA")):
        return (
            f"it refuses the agent's certificate ({words}): give the board the CA that has signed"
            " it, and look at the name that it connects to and at its clock"
        )
    if reason in _OLD:
        return f"it has no TLS 1.2 or later, or no cipher of today ({words}): update its TLS"
    if isinstance(error, (ConnectionError, ssl.SSLEOFError, ssl.SSLZeroReturnError)):
        return (
            "it has closed the connection during the handshake; if it goes on doing so, look at"
            " what it says of the agent's certificate"
        )
    return f"the handshake fails ({words}): what it sends is no TLS that is known here"


_OLD: Final = (
    "UNSUPPORTED_PROTOCOL", "NO_SHARED_CIPHER", "NO_SHARED_SIGNATURE_ALGORITHMS",
    "NO_SUITABLE_SIGNATURE_ALGORITHM", "NO_SUITABLE_KEY_SHARE", "VERSION_TOO_LOW",
    "WRONG_SSL_VERSION",
)  # fmt: skip


def tls_server(
    port: int, host: str, cert: str | None, key: str | None, ca: str | None
) -> TlsServer:
    """The server that the three options ask for. Raises TransportError."""
    for option, path in (("--tls-cert", cert), ("--tls-key", key)):
        if path is None:
            raise TransportError(
                errno.EINVAL, f"{option} is missing: TLS needs --tls-cert FILE and --tls-key FILE;"
                " docs/security.md has the commands that make them",
            )  # fmt: skip
    assert cert is not None and key is not None
    return TlsServer(port, host, Certificates(cert, key, ca))
