"""The agent's certificate, its key and the CA of its clients: files that become an SSLContext."""

from __future__ import annotations

import errno
import os
import re
import ssl
from typing import Final

from .base import TransportError

# A chain of certificates has some kilobytes.
MAX_FILE: Final = 1024 * 1024
# Attack: sessions that may be resumed, of which OpenSSL keeps 20,000 with their certificates, for
# clients of TLS 1.2 that leave with a farewell. A new context forgets them.
MAX_SESSIONS: Final = 256
_HELP: Final = "docs/security.md has the commands"


class Certificates:
    """What a port speaks TLS with; ``ca`` is None where anybody may come.

    Raises TransportError that names the option, the file and the remedy.
    """

    def __init__(self, cert: str, key: str, ca: str | None = None) -> None:
        self.cert = cert
        self.key = key
        self.ca = ca
        self._context = self._load()
        self._seen = self._look()
        self._broken = False  # since the last change they cannot be used

    def context(self) -> ssl.SSLContext:
        """For the next handshake: new where the files are.

        Raises TransportError, once after each change, where they cannot be used; the former
        ones stay in use.
        """
        seen = self._look()
        full = not self._broken and self._context.session_stats()["number"] > MAX_SESSIONS
        if full or seen != self._seen:
            self._seen = seen
            self._broken = True
            self._context = self._load()
            self._broken = False
        return self._context

    def _look(self) -> tuple[tuple[int, int, int], ...]:
        """What changes when a file does."""
        found = []
        for path in (self.cert, self.key, self.ca):
            try:
                it = os.stat(path or "")
                found.append((it.st_mtime_ns, it.st_ino, it.st_size))
            except OSError:
                found.append((0, 0, 0))
        return tuple(found)

    def _load(self) -> ssl.SSLContext:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        # Attack: a client that wants to begin again and again, which costs the agent the most.
        # (OpenSSL 3 refuses it by itself.)
        context.options |= ssl.OP_NO_RENEGOTIATION
        context.options |= ssl.OP_NO_TICKET | ssl.OP_NO_COMPRESSION
        context.num_tickets = 0
        cert = _read("--tls-cert", self.cert)
        if not re.search(r"-----BEGIN [A-Z0-9 ]*CERTIFICATE-----", cert):
            raise _trouble("--tls-cert", self.cert, _no_certificate(self.cert))
        self._load_own(context, cert)
        if self.ca is not None:
            try:
                context.load_verify_locations(cadata=_read("--tls-ca", self.ca))
            except (ssl.SSLError, ValueError) as error:
                raise _trouble("--tls-ca", self.ca, _no_certificate(self.ca)) from error
            context.verify_mode = ssl.CERT_REQUIRED
        return context

    def _load_own(self, context: ssl.SSLContext, cert: str) -> None:
        key = _read("--tls-key", self.key)

        def encrypted() -> str:
            """Without this, OpenSSL would ask at the terminal, and wait."""
            raise _trouble(
                "--tls-key", self.key, "is encrypted, and an agent has nobody to ask for the"
                f" password: write it in the clear (openssl pkey -in {self.key} -out NEW), readable"
                " for the agent's user only",
            )  # fmt: skip

        if not re.search(r"-----BEGIN [A-Z0-9 ]*PRIVATE KEY-----", key):
            raise _trouble(
                "--tls-key", self.key, "holds no private key in PEM form (-----BEGIN PRIVATE"
                f" KEY-----): give the file that was made with the certificate; {_HELP}",
            )  # fmt: skip
        try:
            context.load_cert_chain(self.cert, self.key, encrypted)
        except ssl.SSLError as error:
            if error.reason == "KEY_VALUES_MISMATCH":
                raise _trouble(
                    "--tls-key", self.key, f"does not belong to the certificate {self.cert}: give"
                    " the two that were made together",
                ) from error  # fmt: skip
            if error.reason in _WEAK:
                raise _trouble(
                    "--tls-cert", self.cert, f"is too weak ({_words(error)}): make a new one, with"
                    f" an EC key, or RSA with 2048 bits or more; {_HELP}",
                ) from error  # fmt: skip
            if not _is_sound(cert):
                raise _trouble("--tls-cert", self.cert, _no_certificate(self.cert)) from error
            raise _trouble(
                "--tls-key", self.key, f"holds a key that cannot be used ({_words(error)}): make a"
                f" new one; {_HELP}",
            ) from error  # fmt: skip
        except OSError as error:
            if isinstance(error, TransportError):
                raise
            raise _trouble("--tls-cert", self.cert, f"cannot be read: {error.strerror}") from error

    def doubt(self) -> str:
        """Why those who look at the agent's certificate will not have it, or nothing.

        By a handshake within this process, which is done as soon as it is known.
        """
        theirs = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        theirs.check_hostname = False
        try:
            # The certificate vouches for itself, whoever has signed it: this is about its dates.
            theirs.load_verify_locations(cadata=_read("--tls-cert", self.cert))
            theirs.verify_flags |= 0x80000  # X509_V_FLAG_PARTIAL_CHAIN
            ours = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._load_own(ours, _read("--tls-cert", self.cert))
            there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
            ends = (
                theirs.wrap_bio(back, there), ours.wrap_bio(there, back, server_side=True)
            )  # fmt: skip
            for _ in range(10):
                for end in ends:
                    try:
                        end.do_handshake()
                    except ssl.SSLWantReadError:
                        pass
        except ssl.SSLCertVerificationError as error:
            return str(error.verify_message)
        except OSError as error:
            return error.strerror or str(error)
        return ""


_WEAK: Final = ("EE_KEY_TOO_SMALL", "CA_KEY_TOO_SMALL", "CA_MD_TOO_WEAK", "EE_MD_TOO_WEAK")


def _words(error: ssl.SSLError) -> str:
    """OpenSSL's reason in words."""
    return (error.reason or "of no known form").replace("_", " ").lower()


def _trouble(option: str, path: str, what: str) -> TransportError:
    return TransportError(errno.EINVAL, f"{option} {path} {what}")


def _no_certificate(path: str) -> str:
    return (
        "holds no sound certificate in PEM form (-----BEGIN CERTIFICATE-----): if it is in DER,"
        f" openssl x509 -inform DER -in {path} -out NEW; {_HELP}"
    )


def _is_sound(cert: str) -> bool:
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cadata=cert)
    except (ssl.SSLError, ValueError):
        return False
    return True


def _read(option: str, path: str) -> str:
    """The text of a file; what is no text becomes some that is no certificate."""
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_FILE + 1)
    except PermissionError as error:
        raise _trouble(
            option, path, "cannot be read: permission denied: let the agent's user read it"
            " (chown, or chmod 640 and its group)",
        ) from error  # fmt: skip
    except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
        why = getattr(error, "strerror", None) or str(error)
        raise _trouble(option, path, f"cannot be read: {why}: mend the name; {_HELP}") from error
    if len(data) > MAX_FILE:
        raise _trouble(option, path, f"is over {MAX_FILE} bytes: that is no certificate or key")
    return data.decode("ascii", "backslashreplace")
