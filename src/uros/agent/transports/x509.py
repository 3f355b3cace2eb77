"""Reads dates, names and serial numbers of certificates and of revocation lists (RFC 5280).

OpenSSL verifies them; Python's ``ssl`` does not tell when a file's certificates end, nor what a
revocation list contains, before a board connects.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from datetime import datetime, timezone
from typing import Final, NamedTuple

_SEQUENCE: Final = 0x30
_INTEGER: Final = 0x02
_UTC_TIME: Final = 0x17
_GENERALIZED_TIME: Final = 0x18
_VERSION: Final = 0xA0


class Certificate(NamedTuple):
    """What is read of a certificate.

    Attributes:
        serial: Its serial number.
        issuer: The encoded name of its authority.
        subject: The encoded name of its owner.
        begins: From when on it is valid, in seconds since 1970.
        ends: Until when.
    """

    serial: int
    issuer: bytes
    subject: bytes
    begins: float
    ends: float


class RevocationList(NamedTuple):
    """What is read of a certificate revocation list.

    Attributes:
        issuer: The encoded name of its authority.
        begins: When it was made, in seconds since 1970.
        ends: When the next list should have come; None if it has no end.
        serials: The serial numbers of the revoked certificates.
    """

    issuer: bytes
    begins: float
    ends: float | None
    serials: frozenset[int]


def certificates_in(pem: str) -> list[Certificate]:
    """Return the certificates of a PEM text; raises ValueError for what is no certificate."""
    return [certificate(der) for der in _blocks(pem, r"(?:X509 |TRUSTED )?CERTIFICATE")]


def revocation_lists_in(pem: str) -> list[RevocationList]:
    """Return the revocation lists of a PEM text; raises ValueError for what is none."""
    return [_revocation_list(der) for der in _blocks(pem, "X509 CRL")]


def certificate(der: bytes) -> Certificate:
    """Return a certificate in DER form; raises ValueError for what is none."""
    fields = list(_items(_first(_first(der, _SEQUENCE), _SEQUENCE)))
    if fields and fields[0][0] == _VERSION:
        del fields[0]
    if len(fields) < 5 or fields[0][0] != _INTEGER:
        raise ValueError("no certificate")
    begins, ends = (_time(tag, value) for tag, value, _ in _items(fields[3][1]))
    serial = int.from_bytes(fields[0][1], "big", signed=True)
    return Certificate(serial, fields[2][2], fields[4][2], begins, ends)


def _revocation_list(der: bytes) -> RevocationList:
    fields = list(_items(_first(_first(der, _SEQUENCE), _SEQUENCE)))
    if fields and fields[0][0] == _INTEGER:  # the version
        del fields[0]
    if len(fields) < 3:
        raise ValueError("no revocation list")
    issuer, begins, rest = fields[1][2], _time(*fields[2][:2]), fields[3:]
    ends = None
    if rest and rest[0][0] in (_UTC_TIME, _GENERALIZED_TIME):
        ends = _time(*rest.pop(0)[:2])
    serials = set()
    if rest and rest[0][0] == _SEQUENCE:
        for _, entry, _ in _items(rest[0][1]):
            serials.add(int.from_bytes(_first(entry, _INTEGER), "big", signed=True))
    return RevocationList(issuer, begins, ends, frozenset(serials))


def _blocks(pem: str, label: str) -> Iterator[bytes]:
    for match in re.finditer(rf"-----BEGIN {label}-----([^-]*)-----END {label}-----", pem):
        yield base64.b64decode(match[1])


def _items(data: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield tag, content, and all bytes of each element of DER (X.690)."""
    at = 0
    while at < len(data):
        start, tag, size = at, data[at], data[at + 1] if at + 1 < len(data) else -1
        at += 2
        if size & 0x80:
            count = size & 0x7F
            size = int.from_bytes(data[at : at + count], "big")
            at += count
        if size < 0 or at + size > len(data):
            raise ValueError("an element is cut off")
        yield tag, data[at : at + size], data[start : at + size]
        at += size


def _first(data: bytes, wanted: int) -> bytes:
    tag, content, _ = next(_items(data), (-1, b"", b""))
    if tag != wanted:
        raise ValueError("an element of another kind")
    return content


def _time(tag: int, value: bytes) -> float:
    text = value.decode("ascii")
    if tag == _UTC_TIME:  # of two digits; 50 to 99 are of the 20th century
        text = ("19" if text[:2] >= "50" else "20") + text
    moment = datetime.strptime(text, "%Y%m%d%H%M%SZ")
    return moment.replace(tzinfo=timezone.utc).timestamp()
