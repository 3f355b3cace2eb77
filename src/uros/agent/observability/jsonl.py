"""The text format of captures and of ``uros trace``: one JSON line a message.

The format of the recordings of C++ agents in ``tests/captures``, with more fields::

    {"t": 1763750000.123456, "from": "client", "client": 0, "transport": "UDPv4Agent",
     "address": "192.0.2.7:2018", "key": "0x4B0CBE99", "hex": "8180..."}

``t`` is in seconds since 1970; ``client`` numbers the addresses from 0.
"""

from __future__ import annotations

import json
from typing import Final

from ..objects.kinds import key_label
from ..transports.base import ServerTransport
from .message_hooks import MessageEvent

# The most addresses that have a number, because messages may come from endless forged ones. Then
# the numbers start from 0 again.
_MAX_CLIENTS: Final = 65536


class JsonLinesEncoder:
    """Encodes messages as JSON lines."""

    def __init__(self) -> None:
        # What the lines of one transport and address have in common.
        self._places: dict[tuple[ServerTransport, str], str] = {}

    def reset(self) -> None:
        """Begin a new file; clients keep their numbers in it."""

    def encode(self, event: MessageEvent, lost: int) -> bytes:
        """Return the line of a message; ``lost`` messages before it were not captured."""
        transport, _, direction, message, now, key = event
        address = transport.address(event.peer)
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
