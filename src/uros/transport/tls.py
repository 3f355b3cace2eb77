"""Client transport over TLS. Runs on MicroPython ports that have a network and ``ssl``.

    TlsTransport("agent.example", 8888, ca="ca.pem", cert="board.pem", key="board.key")

Certificates are checked for their dates, too: set the board's clock first
(``ntptime.settime()``), since the agent can send its time only after the handshake.
"""

import binascii
import ssl

from .tcp import TcpTransport

try:
    from typing import Any, Final

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

_CHUNK: Final = 1024


class _Never(Exception):
    pass


# CPython raises these where MicroPython's read and write give None.
_WANT_READ: Final = getattr(ssl, "SSLWantReadError", _Never)
_WANT_WRITE: Final = getattr(ssl, "SSLWantWriteError", _Never)


_BEGIN: Final = b"-----BEGIN "


def _bytes_of(source: "Any") -> bytes:
    """Return the content of a file by its name; bytes are returned as they are."""
    if isinstance(source, str):
        with open(source, "rb") as file:
            return file.read()
    data: bytes = source
    return data


def _der(data: bytes) -> bytes:
    """Return the first object of a PEM text as DER, which is all that MicroPython 1.27 accepts."""
    at = data.find(_BEGIN)
    if data[at:].startswith(_BEGIN + b"EC PARA"):  # openssl puts these before a key
        at = data.find(_BEGIN, at + 1)
    if at < 0:
        return data
    start = data.find(b"\n", at)
    stop = data.find(b"-----END ", at)
    if start < 0 or stop < 0:
        raise ValueError("PEM without an end")
    return binascii.a2b_base64(data[start:stop])


def _refused(error: Exception) -> OSError:
    """Return OSError for MicroPython's ValueError, whose text has several lines."""
    return OSError("the agent's certificate is refused: " + str(error).strip())


def _said(error: "Any") -> "Any":
    """Return the error, or one with the remedy if the agent has said that it refuses the board."""
    text = str(error)
    if "ALERT" in text.upper():
        return OSError("the agent refuses the connection, its log has why and the remedy: " + text)
    return error


class TlsTransport(TcpTransport):
    """A :class:`~uros.transport.tcp.TcpTransport` in TLS.

    Files are read at each :meth:`open`.

    Args:
        host: See TcpTransport, as ``port``, ``mtu`` and ``patience_ms``.
        port: The agent's port.
        mtu: The largest message in bytes.
        ca: Certificate that signed the agent's, or that one itself: a file's name, or PEM or DER.
        cert: The board's certificate, for agents that ask for one: a file's name, PEM (on
            MicroPython DER too).
        key: Its private key, in the same form.
        name: The host name in the agent's certificate; ``host`` by default.
        verify: False accepts any certificate, which is for a test bench only.
        patience_ms: See TcpTransport.

    Raises:
        ValueError: ``ca`` is missing, or one of ``cert`` and ``key``.
    """

    def __init__(
        self, host: str, port: int = 8888, mtu: int = 512, ca: "str | bytes | None" = None,
        cert: "str | None" = None, key: "str | None" = None, name: "str | None" = None,
        verify: bool = True, patience_ms: int = 10000,
    ) -> None:  # fmt: skip
        super().__init__(host, port, mtu, patience_ms)
        if verify and ca is None:
            raise ValueError("ca is missing: the certificate to know the agent by")
        if (cert is None) != (key is None):
            raise ValueError("cert and key belong together")
        self._ca = ca
        self._cert = cert
        self._key = key
        self._name = name or host
        self._verify = verify
        self._context: "Any" = None

    def open(self) -> None:
        """Begin to connect. Raises OSError also if a certificate or key cannot be used."""
        try:
            self._context = self._make_context()
        except ValueError as error:
            raise OSError("a certificate or key cannot be used: %s" % error)
        super().open()

    def _make_context(self) -> "Any":
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        full = hasattr(context, "check_hostname")  # CPython's
        if self._verify:
            context.verify_mode = ssl.CERT_REQUIRED  # MicroPython begins with CERT_NONE
            ca = _bytes_of(self._ca)
            pem = full and _BEGIN in ca
            context.load_verify_locations(cadata=ca.decode() if pem else _der(ca))
        else:
            if full:
                context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        if self._cert is not None and full:
            context.load_cert_chain(self._cert, self._key)
        elif self._cert is not None:
            context.load_cert_chain(_der(_bytes_of(self._cert)), _der(_bytes_of(self._key)))
        return context

    def _begin(self, sock: "Any") -> "Any":
        return self._context.wrap_socket(
            sock, server_hostname=self._name, do_handshake_on_connect=False
        )

    # The handshake is made by the first of these calls, on both Pythons.

    def _read(self) -> "bytes | None":
        try:
            data: "bytes | None" = self._line.read(_CHUNK)
            return data
        except _WANT_READ:
            return None
        except _WANT_WRITE:
            self._writing = True
            return None
        except ValueError as error:
            raise _refused(error)
        except OSError as error:
            raise _said(error)

    def _write(self, data: "Buffer") -> "int | None":
        try:
            return self._line.write(data) or 0
        except _WANT_READ:
            return None
        except _WANT_WRITE:
            return 0
        except ValueError as error:
            raise _refused(error)
        except OSError as error:
            self._read()  # raises what the agent has said before it closed the connection
            raise error
