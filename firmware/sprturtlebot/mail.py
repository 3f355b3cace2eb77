"""Messages from one core to the other: all that the two share."""

# Their numbers. The odometry is asked for and answered under the same one.
POWER, COMMAND, ODOMETRY, NOTE = 100, 101, 102, 103
_COUNT = 4

try:
    from typing import Any
except ImportError:
    pass


class Mailbox:
    """One way, from one core to one other. The newest message of each number waits, so a flood of
    them fills nothing, and none waits for the other core; they are taken in the order of their
    numbers. The sender writes what the receiver only reads: no lock is needed.
    """

    def __init__(self) -> None:
        self.value: "Any" = None
        self._values: "list[Any]" = [None] * _COUNT
        self._sent = [0] * _COUNT
        self._taken = [0] * _COUNT

    def send(self, number: int, value: "Any" = None) -> None:
        """Leave a message. ``value`` belongs to the receiver from then on."""
        at = number - POWER
        self._values[at] = value
        self._sent[at] = (self._sent[at] + 1) & 0xFFFF

    def receive(self) -> int:
        """The number of the next message, whose value is in ``value``; 0: there is none."""
        for at in range(_COUNT):
            sent = self._sent[at]
            if sent != self._taken[at]:
                self._taken[at] = sent
                self.value = self._values[at]
                return POWER + at
        return 0
