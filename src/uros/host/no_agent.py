"""Says on standard error that no agent answers a node with a transport."""

from __future__ import annotations

import sys
import time
from typing import Any, Final

from ..printable import printable

# Seconds of spinning without an agent. An agent that runs answers within one.
PATIENCE: Final = 3.0
# By the class of the transport, which a program has imported itself.
_COMMANDS: Final = {
    "UdpTransport": "uros agent udp4 --port N",
    "TcpTransport": "uros agent tcp4 --port N",
    "StreamTransport": "uros agent serial --dev DEVICE",
}


class NoAgentNotice:
    """Prints one line if the first session of a connection takes long.

    Args:
        connection: The connection of the node.
        name: The node's name.
    """

    def __init__(self, connection: Any, name: str) -> None:
        self._connection = connection
        self._name = name
        self._at: float | None = None
        self._done = False

    def left(self) -> float | None:
        """Return the seconds until the line is due, and print it then; None if it never is."""
        if self._done or self._connection.connections:
            self._done = True
            return None
        now = time.monotonic()
        if self._at is None:
            self._at = now + PATIENCE
        if now < self._at:
            return self._at - now
        self._done = True
        example = _COMMANDS.get(type(self._connection.transport).__name__)
        command = f": start one, such as '{example}', or" if example else ":"
        print(
            printable(
                f"uros: no agent has answered the node {self._name} for {PATIENCE:g} s{command}"
                " check the address; the node goes on trying"
            ),
            file=sys.stderr,
            flush=True,
        )
        return None
