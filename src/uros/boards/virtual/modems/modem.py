"""What the modelled modems share: an access point, one UDP link, and delayed responses.

Runs on MicroPython too.
"""

try:
    from collections.abc import Callable
    from typing import Any
except ImportError:  # MicroPython
    pass


class Modem:
    """A modem with one UDP link.

    Attributes:
        network: The access points in range and the hosts behind them.
        faults: The faults that are injected.
        joined: The name of the access point that the modem has joined, or "".
        link: The UDP link, or None.
        commands: All commands received.

    Args:
        network: See the attribute.
        ms: Returns the time in milliseconds.
    """

    def __init__(self, network: "Any", ms: "Callable[[], int]") -> None:
        self.network = network
        self.faults: set[str] = set()
        self.joined = ""
        self.link: Any = None
        self.commands: list[bytes] = []
        self._ms = ms
        self._echo = True
        self._timers: list[tuple[int, Callable[[], object]]] = []

    def _power_up(self) -> None:
        """Set the state after power-on; faults and the list of commands stay."""
        self._drop_link()
        self.joined = ""
        self._echo = True
        self._timers = []

    def _drop_link(self) -> bool:
        """Close the link; return whether there was one."""
        link, self.link = self.link, None
        if link is not None:
            link.close()
        return link is not None

    def _after(self, ms: int, do: "Callable[[], object]") -> None:
        if ms:
            self._timers.append((self._ms() + ms, do))
        else:
            do()

    def _run_timers(self) -> None:
        now = self._ms()
        due = [timer for timer in self._timers if timer[0] <= now]
        self._timers = [timer for timer in self._timers if timer[0] > now]
        for _, do in due:
            do()
