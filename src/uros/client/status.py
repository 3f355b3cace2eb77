"""What a person sees of a board's program: an LED that is on while there is an agent, and words."""

from .connection import AGENT_CONNECTED

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

_TOGGLE_S: Final = 0.1


class StatusLed:
    """Shows on ``led``, a pin or whatever has ``value(level)``, how ``node`` is: on while it is
    connected, else toggled ten times a second.

    ``say`` gets a line each time that an agent is found, and one with the reason why there is none,
    again when that is another.
    """

    def __init__(self, node: "Any", led: "Any", say: "Callable[[str], object]" = print) -> None:
        self._connection: "Any" = node.connection
        self._led = led
        self._say = say
        self._level = False
        self._connections = 0
        self._told: "str | None" = None  # why there is no agent
        node.create_timer(_TOGGLE_S, self._look)

    def _look(self) -> None:
        connection = self._connection
        connected = connection.state == AGENT_CONNECTED
        if connected:
            # The count tells of an agent that was lost and found since the last look, too.
            if self._connections != connection.connections:
                self._connections = connection.connections
                self._told = None
                self._say("connected to the agent")
        elif self._told != connection.reason:
            self._told = connection.reason
            self._say("no agent: " + self._told if self._told else "looking for the agent")
        self._level = connected or not self._level
        self._led.value(self._level)
