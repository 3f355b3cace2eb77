"""Loads the agent's certificate, its key, and of its clients the CA and the revocation list."""

from __future__ import annotations

import errno
import os
import re
import ssl
from collections.abc import Callable
from datetime import datetime, timezone
from typing import Final, TypeVar

from .base import TransportError
from .x509 import Certificate, RevocationList, certificate, certificates_in, revocation_lists_in

_T = TypeVar("_T")

# The largest file that is read, in bytes; a chain of certificates has some kilobytes.
MAX_FILE: Final = 1024 * 1024
# The most resumable sessions: OpenSSL keeps 20,000 with their certificates, for clients of TLS 1.2
# that close properly. A new context drops them.
MAX_SESSIONS: Final = 256
_DAY_SECONDS: Final = 86_400.0
# So many seconds before a certificate ends, its end is announced.
SOON: Final = 30 * _DAY_SECONDS
_HELP: Final = "docs/security.md has the commands"


class Certificates:
    """The certificate, key, CA and revocation list of a TLS port.

    Args:
        cert: File of the certificate.
        key: File of its private key.
        ca: File of the CA of the clients; None to admit clients without a certificate.
        crl: File of the CA's certificate revocation lists; None without.

    Raises:
        TransportError: A file cannot be used; the text has the option, the file and the remedy.
    """

    def __init__(self, cert: str, key: str, ca: str | None = None, crl: str | None = None) -> None:
        self.cert = cert
        self.key = key
        self.ca = ca
        self.crl = crl
        self._own: list[Certificate] = []
        self._authorities: list[Certificate] = []
        self._revocations: list[RevocationList] = []
        self._context = self._load()
        self._seen = self._look()
        self._refused = ""  # why the files cannot be used since their last change

    def context(self) -> ssl.SSLContext:
        """Return the context for the next handshake; files that changed are loaded again.

        Raises TransportError, once after each change, if they cannot be used; the former
        context stays in use.
        """
        stamps = self._look()
        full = not self._refused and self._context.session_stats()["number"] > MAX_SESSIONS
        if full or stamps != self._seen:
            self._seen = stamps
            self.reload()
        return self._context

    def reload(self) -> None:
        """Load the files again; raises TransportError, and keeps the former ones, if they are bad.

        Clients of open connections stay, but see :meth:`is_revoked`.
        """
        try:
            self._context = self._load()
        except TransportError as error:
            self._refused = error.strerror or str(error)
            raise
        self._refused = ""

    def is_revoked(self, der: bytes) -> bool:
        """Return whether a revocation list has the certificate, which is in DER form."""
        try:
            shown = certificate(der)
        except ValueError:  # OpenSSL has verified it, and checks the list at each handshake
            return False
        return any(
            shown.issuer == revoked.issuer and shown.serial in revoked.serials
            for revoked in self._revocations
        )

    def _look(self) -> tuple[tuple[int, int, int], ...]:
        """Return time, inode and size of the files, to detect changes."""
        stamps = []
        for path in (self.cert, self.key, self.ca, self.crl):
            try:
                status = os.stat(path or "")
                stamps.append((status.st_mtime_ns, status.st_ino, status.st_size))
            except OSError:
                stamps.append((0, 0, 0))
        return tuple(stamps)

    def _load(self) -> ssl.SSLContext:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        # A client must not renegotiate again and again, which costs the agent the most. (OpenSSL 3
        # refuses it by itself.)
        context.options |= ssl.OP_NO_RENEGOTIATION
        context.options |= ssl.OP_NO_TICKET | ssl.OP_NO_COMPRESSION
        context.num_tickets = 0
        cert = _read("--tls-cert", self.cert)
        if not re.search(r"-----BEGIN [A-Z0-9 ]*CERTIFICATE-----", cert):
            raise _trouble("--tls-cert", self.cert, _no_certificate(self.cert))
        self._load_own(context, cert)
        authorities, revocations = "", ""
        if self.ca is not None:
            authorities = _read("--tls-ca", self.ca)
            try:
                context.load_verify_locations(cadata=authorities)
            except (ssl.SSLError, ValueError) as error:
                raise _trouble("--tls-ca", self.ca, _no_certificate(self.ca)) from error
            context.verify_mode = ssl.CERT_REQUIRED
        if self.crl is not None:
            revocations = self._load_crl(context, self.crl)
        self._own = _known(certificates_in, cert)
        self._authorities = _known(certificates_in, authorities)
        self._revocations = _known(revocation_lists_in, revocations)
        return context

    def _load_crl(self, context: ssl.SSLContext, crl: str) -> str:
        """Load the revocation lists; from now on the context asks for one of each client's CA."""
        text = _read("--tls-crl", crl)
        if self.ca is None:
            raise _trouble("--tls-crl", crl, "has no effect without --tls-ca: name the CA too")
        # A certificate in the file would be trusted as a CA.
        if "-----BEGIN X509 CRL-----" not in text or re.search(
            r"BEGIN [A-Z0-9 ]*CERTIFICATE", text
        ):
            raise _trouble(
                "--tls-crl", crl, "holds no revocation list in PEM form (-----BEGIN X509 CRL-----),"
                f" or something else too; {_HELP}",
            )  # fmt: skip
        try:
            context.load_verify_locations(crl)
        except (ssl.SSLError, OSError) as error:
            raise _trouble("--tls-crl", crl, f"holds no valid revocation list; {_HELP}") from error
        context.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF
        return text

    def _load_own(self, context: ssl.SSLContext, cert: str) -> None:
        key = _read("--tls-key", self.key)

        def encrypted() -> str:
            """Raise; without this function OpenSSL would ask for the password at the terminal."""
            raise _trouble(
                "--tls-key", self.key, "is encrypted, and an agent cannot ask for the"
                f" password: store it without one (openssl pkey -in {self.key} -out NEW), readable"
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
                    " the pair that was made together",
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

    def doubts(self, now: float) -> list[str]:
        """Return what will keep boards from connecting, today or soon; each with the remedy.

        Args:
            now: The time in seconds since 1970.
        """
        found = self._invalid(now, SOON)
        if self._without_list():
            found.append(self._no_list())
        if not any(f"--tls-cert {self.cert}" in each for each in found) and (why := self.doubt()):
            found.append(f"--tls-cert {self.cert}: {why}; make a new one ({_HELP})")
        return found

    def troubles(self, now: float) -> list[str]:
        """Return which files are not valid now, and why new ones are refused, with the remedies.

        Args:
            now: The time in seconds since 1970.
        """
        found = self._invalid(now, 0.0)
        # A CA that signs only another one, which signs the boards' certificates, needs no list.
        if self._authorities and len(self._without_list()) == len(self._authorities):
            found.append(self._no_list())
        if self._refused:
            found.append(f"new files are refused, and a restart would fail: {self._refused}")
        return found

    def admits_boards(self, now: float) -> bool:
        """Return whether the dates of the files let any board connect.

        Boards that verify the agent refuse a certificate that has ended, and the agent refuses
        boards of a CA that has ended, or that has no revocation list of today.

        Args:
            now: The time in seconds since 1970.
        """
        current = {
            revoked.issuer
            for revoked in self._revocations
            if revoked.begins <= now and (revoked.ends is None or now <= revoked.ends)
        }
        admitting = (
            _is_valid(each, now) and (not self._revocations or each.subject in current)
            for each in self._authorities
        )
        own = self._own[:1]
        return all(_is_valid(each, now) for each in own) and (
            not self._authorities or any(admitting)
        )

    def not_after(self) -> dict[str, float]:
        """Return when the first certificate or list in each file ends, in seconds since 1970.

        The keys are those of the options, such as ``tls_cert``. A file without an end is missing.
        """
        ends = {
            "tls_cert": [each.ends for each in self._own[:1]],
            "tls_ca": [each.ends for each in self._authorities],
            "tls_crl": [each.ends for each in self._revocations if each.ends is not None],
        }
        return {option: min(times) for option, times in ends.items() if times}

    def _without_list(self) -> list[Certificate]:
        """Return the CAs of which the file of revocation lists has none."""
        if not self._revocations:
            return []
        listed = {revoked.issuer for revoked in self._revocations}
        return [each for each in self._authorities if each.subject not in listed]

    def _no_list(self) -> str:
        return (
            f"--tls-crl {self.crl}: it has no list of one of the CAs of {self.ca}, so no board of"
            f" that CA is admitted: append its list; {_HELP}"
        )

    def _invalid(self, now: float, soon: float) -> list[str]:
        """Return what is not valid now, or ends within ``soon`` seconds; each with the remedy."""
        found = [
            *_dates("--tls-cert", self.cert, self._own[:1], now, soon),
            *_dates("--tls-ca", self.ca or "", self._authorities, now, soon),
        ]
        for revoked in self._revocations:
            if revoked.ends is not None and revoked.ends < now:
                found.append(
                    f"--tls-crl {self.crl}: a revocation list ended on {_day(revoked.ends)}, so no"
                    f" board of its CA is admitted: make a new one; {_HELP}"
                )
            elif revoked.begins > now:
                found.append(
                    f"--tls-crl {self.crl}: a revocation list is valid from {_day(revoked.begins)}"
                    " on, so no board of its CA is admitted: is this machine's clock right?"
                )
            elif revoked.ends is not None and revoked.ends < now + min(soon, _notice(revoked)):
                found.append(f"--tls-crl {self.crl}: a revocation list ends on"
                             f" {_day(revoked.ends)}: make a new one before")  # fmt: skip
        return found

    def doubt(self) -> str:
        """Return why boards that verify the certificate will refuse it; "" if they will not.

        It is found by a handshake within this process.
        """
        client_context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        client_context.check_hostname = False
        try:
            # The certificate is its own trust anchor: only its dates are checked.
            client_context.load_verify_locations(cadata=_read("--tls-cert", self.cert))
            client_context.verify_flags |= 0x80000  # X509_V_FLAG_PARTIAL_CHAIN
            server_context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._load_own(server_context, _read("--tls-cert", self.cert))
            to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
            ends = (
                client_context.wrap_bio(to_client, to_server),
                server_context.wrap_bio(to_server, to_client, server_side=True),
            )
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


def _notice(revoked: RevocationList) -> float:
    """Return how many seconds before a revocation list ends its end is announced.

    It is a tenth of the list's lifetime, but at least a day. For lists that live for two days or
    less it is half of the lifetime, since a new one would be announced at once otherwise.
    """
    if revoked.ends is None:
        return 0.0
    lifetime = revoked.ends - revoked.begins
    return min(max(lifetime / 10, _DAY_SECONDS), lifetime / 2)


def _known(read: Callable[[str], list[_T]], pem: str) -> list[_T]:
    """Return what is read of a file that OpenSSL accepts; nothing if its form is unusual."""
    try:
        return read(pem)
    except ValueError:
        return []


def _is_valid(each: Certificate, now: float) -> bool:
    return each.begins <= now <= each.ends


def _dates(option: str, path: str, files: list[Certificate], now: float, soon: float) -> list[str]:
    """Return which of the certificates in a file are not valid, or end within ``soon`` seconds."""
    found = []
    for each in files:
        if each.ends < now:
            found.append(f"{option} {path} expired on {_day(each.ends)}: make a new one; {_HELP}")
        elif each.begins > now:
            found.append(
                f"{option} {path} is valid from {_day(each.begins)} on: is this machine's clock"
                " right?"
            )
        elif each.ends < now + soon:
            found.append(
                f"{option} {path} expires on {_day(each.ends)}: make a new one before; {_HELP}"
            )
    return found


def _day(moment: float) -> str:
    return f"{datetime.fromtimestamp(moment, timezone.utc):%Y-%m-%d}"


_WEAK: Final = ("EE_KEY_TOO_SMALL", "CA_KEY_TOO_SMALL", "CA_MD_TOO_WEAK", "EE_MD_TOO_WEAK")


def _words(error: ssl.SSLError) -> str:
    """Return OpenSSL's reason in words."""
    return (error.reason or "of no known form").replace("_", " ").lower()


def _trouble(option: str, path: str, reason: str) -> TransportError:
    return TransportError(errno.EINVAL, f"{option} {path} {reason}")


def _no_certificate(path: str) -> str:
    return (
        "holds no valid certificate in PEM form (-----BEGIN CERTIFICATE-----): if it is in DER,"
        f" openssl x509 -inform DER -in {path} -out NEW; {_HELP}"
    )


def _is_sound(cert: str) -> bool:
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cadata=cert)
    except (ssl.SSLError, ValueError):
        return False
    return True


def _read(option: str, path: str) -> str:
    """Read a file as text; other bytes become text that is no certificate."""
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
        raise _trouble(option, path, f"cannot be read: {why}: correct the name; {_HELP}") from error
    if len(data) > MAX_FILE:
        raise _trouble(option, path, f"is over {MAX_FILE} bytes: that is no certificate or key")
    return data.decode("ascii", "backslashreplace")
