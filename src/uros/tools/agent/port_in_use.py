"""Names the process that has the port which an agent wants, as when it is started twice."""

from __future__ import annotations

import re
from typing import Final

from ..doctor.process import can_look, taken_port

# As agent.transports.ip writes it, which does not look into other processes.
_PORT: Final = re.compile(r"(UDP|TCP) port (\d+) is in use, perhaps by another agent")


def name_holder(message: str) -> str:
    """Return an error message with the process that has the port, if it is about a port in use.

    Args:
        message: The text of a TransportError.
    """
    found = _PORT.search(message)
    if found is None or not can_look():
        return message
    taken = taken_port(found[1].lower(), int(found[2]))
    if taken is None:  # free again
        return message
    who = " and ".join(
        f"another agent (pid {holder.pid})" if holder.is_uros_agent else str(holder)
        for holder in taken.holders
    )
    who = who or f"a process of another user (sudo ss -lpn 'sport = :{taken.port}')"
    head = f"{found[1]} port {found[2]} is in use by {who}"
    return message[: found.start()] + head + message[found.end() :]
