"""Which form of request identity the endpoints of others use.

If rmw_fastrtps reads a request with the header of rmw_cyclonedds, it executes it with wrong
arguments, because it takes the 16 octets of the header for the first fields. rmw_cyclonedds, and
uros like it, announces ``clientid=…`` or ``serviceid=…`` in USER_DATA; a GUID that begins 01 0F is
one of Fast DDS. An endpoint without such an id counts as incompatible.
"""

from __future__ import annotations

from typing import Final

from ..guid import FAST_DDS

# What the endpoints of a service client and of a server announce.
CLIENT_ID: Final = b"clientid="
SERVICE_ID: Final = b"serviceid="


def endpoint_id(participant: bytes, number: int) -> str:
    """Return an id for a service client or server, as rmw_cyclonedds writes it.

    Args:
        participant: The GUID of its participant.
        number: Its number there.
    """
    octets = participant[:12] + number.to_bytes(4, "big")
    return ".".join(f"{octet:x}" for octet in octets)


def uses_request_header(guid: bytes, user_data: bytes, role: bytes) -> bool:
    """Return whether an endpoint uses the header of rmw_cyclonedds.

    Args:
        guid: Its GUID.
        user_data: Its USER_DATA.
        role: CLIENT_ID for a service client's endpoint, SERVICE_ID for a server's.
    """
    return role in user_data and not guid.startswith(FAST_DDS)
