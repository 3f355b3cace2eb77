"""What modelled modems share: being in a network, a link there, and answers that take their time.

Runs on MicroPython too.
"""

try:
    from collections.abc import Callable
    from typing import Any
except ImportError:  # MicroPython
    pass


class Modem:
    """A modem with one UDP link.

    ``ms`` is the time in milliseconds. ``joined`` is the access point's name, or ""; ``link`` the
    UDP link, or None. ``lines`` are all commands that came, ``faults`` what is wrong with it.
    """

    def __init__(self, air: "Any", ms: "Callable[[], int]") -> None:
        self.air = air
        self.faults: set[str] = set()
        self.joined = ""
        self.link: Any = None
        self.lines: list[bytes] = []
        self._ms = ms
        self._echo = True
        self._later: list[tuple[int, Callable[[], object]]] = []

    def _forget(self) -> None:
        """All but the faults and the lines is as if it was just switched on."""
        self._drop_link()
        self.joined = ""
        self._echo = True
        self._later = []

    def _drop_link(self) -> bool:
        """Whether there was one."""
        link, self.link = self.link, None
        if link is not None:
            link.close()
        return link is not None

    def _after(self, ms: int, do: "Callable[[], object]") -> None:
        if ms:
            self._later.append((self._ms() + ms, do))
        else:
            do()

    def _do_due(self) -> None:
        now = self._ms()
        due = [it for it in self._later if it[0] <= now]
        self._later = [it for it in self._later if it[0] > now]
        for _, do in due:
            do()
