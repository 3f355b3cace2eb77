"""Mailboxes between the two cores, which share nothing else."""

# Message numbers. ODOMETRY is the number of the request and of the answer.
POWER, COMMAND, ODOMETRY, NOTE = 100, 101, 102, 103
_COUNT = 4

try:
    from typing import Any
except ImportError:
    pass


class Mailbox:
    """Carries messages in one direction, from one core to the other.

    The mailbox holds the newest message of each number, so a flood takes no memory and no core
    waits for the other. Messages are received in the order of their numbers. Only the sender
    writes, so no lock is needed.
    """

    def __init__(self) -> None:
        self.value: "Any" = None
        self._values: "list[Any]" = [None] * _COUNT
        self._sent = [0] * _COUNT
        self._taken = [0] * _COUNT

    def send(self, number: int, value: "Any" = None) -> None:
        """Send a message. The sender must not change ``value`` afterwards."""
        at = number - POWER
        self._values[at] = value
        self._sent[at] = (self._sent[at] + 1) & 0xFFFF

    def receive(self) -> int:
        """Return the number of the next message and set ``value``; return 0 if there is none."""
        for at in range(_COUNT):
            sent = self._sent[at]
            if sent != self._taken[at]:
                self._taken[at] = sent
                self.value = self._values[at]
                return POWER + at
        return 0
