"""State of the connection for a person: on an LED and as text."""

from .connection import AGENT_CONNECTED

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

_TOGGLE_S: Final = 0.1


class StatusLed:
    """Shows the state of a node's connection on an LED: on if connected, otherwise blinking.

    Args:
        node: The node.
        led: A pin, or another object with ``value(level)``. It is toggled ten times a second while
            not connected.
        say: Called with a line of text each time that an agent is found, and with the reason when
            there is none, again when the reason changes.
    """

    def __init__(self, node: "Any", led: "Any", say: "Callable[[str], object]" = print) -> None:
        self._connection: "Any" = node.connection
        self._led = led
        self._say = say
        self._level = False
        self._connections = 0
        self._reason: "str | None" = None  # why there is no agent
        node.create_timer(_TOGGLE_S, self._look)

    def _look(self) -> None:
        connection = self._connection
        connected = connection.state == AGENT_CONNECTED
        if connected:
            # The count also changes if an agent was lost and found since the last call.
            if self._connections != connection.connections:
                self._connections = connection.connections
                self._reason = None
                self._say("connected to the agent")
        elif self._reason != connection.reason:
            self._reason = connection.reason
            self._say("no agent: " + self._reason if self._reason else "looking for the agent")
        self._level = connected or not self._level
        self._led.value(self._level)
