"""The identity of a request as rmw_cyclonedds writes it: a header before the body.

Between the encapsulation header and the body stand the client's 64-bit id and a 64-bit signed
sequence number, both in the sample's byte order.
"""

from __future__ import annotations

import struct
from typing import Final

from ..base import Bytes, MiddlewareError

_SIZE: Final = 16
_ENCAPSULATION: Final = 4


def insert(cdr: Bytes, client_id: bytes, sequence: int) -> bytes:
    """Return a sample with the header.

    Args:
        cdr: The sample, with its encapsulation header.
        client_id: The client's id, 8 octets little endian.
        sequence: The sequence number of the request.

    Raises:
        MiddlewareError: The sample is big endian.
    """
    if not cdr[1] & 1:
        raise MiddlewareError("big-endian service payloads cannot be passed on")
    view = memoryview(cdr)
    header = client_id + struct.pack("<q", sequence)
    return b"".join((view[:_ENCAPSULATION], header, view[_ENCAPSULATION:]))


def remove(sample: bytes) -> tuple[bytes, int, bytes] | None:
    """Split a sample that has the header.

    Returns:
        The client's id (8 octets little endian), the sequence number, and the sample without the
        header; None for a sample that is too short.
    """
    if len(sample) < _ENCAPSULATION + _SIZE:
        return None
    order = "<" if sample[1] & 1 else ">"
    client, sequence = struct.unpack_from(order + "Qq", sample, _ENCAPSULATION)
    body = sample[:_ENCAPSULATION] + sample[_ENCAPSULATION + _SIZE :]
    return struct.pack("<Q", client), sequence, body
