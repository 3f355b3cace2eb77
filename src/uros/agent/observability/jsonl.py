"""The text form of captures, and of what ``uros trace`` is told: one JSON line a message.

As the recordings of C++ agents in ``tests/captures``, and it says more::

    {"t": 1763750000.123456, "from": "client", "client": 0, "transport": "UDPv4Agent",
     "address": "192.0.2.7:2018", "key": "0x4B0CBE99", "hex": "8180..."}

``t`` is in seconds since 1970, ``client`` counts the addresses.
"""

from __future__ import annotations

import json
from typing import Final

from ..objects.kinds import key_label
from ..transports.base import ServerTransport
from .message_hooks import Passing

# Attack: messages from one address after the other; their numbers start anew then.
_MAX_CLIENTS: Final = 65536


class Lines:
    """Makes the lines of the text form."""

    def __init__(self) -> None:
        # What the lines of a place have in common.
        self._places: dict[tuple[ServerTransport, str], str] = {}

    def reset(self) -> None:
        """Clients keep their numbers in the file that follows."""

    def encode(self, passing: Passing, lost: int) -> bytes:
        """The line of a message; ``lost``: how many before it are not in the file."""
        transport, _, direction, message, now, key = passing
        address = transport.address(passing.peer)
        where = self._places.get((transport, address))
        if where is None:
            if len(self._places) >= _MAX_CLIENTS:
                self._places.clear()
            where = f'{len(self._places)}, "transport": {json.dumps(transport.name)}'
            where += f', "address": {json.dumps(address)}'
            self._places[transport, address] = where
        named = f', "key": "{key_label(key)}"' if key else ""
        missing = f', "lost": {lost}' if lost else ""
        return (
            f'{{"t": {now // 1_000_000}.{now % 1_000_000:06d}, "from": "{direction}", "client":'
            f' {where}{named}{missing}, "hex": "{message.hex()}"}}\n'
        ).encode()
