"""A link to an agent that loses, duplicates and delays messages in both directions.

It leaves alone the messages that the C library repeats only after seconds, or never: CREATE_CLIENT,
DELETE, GET_INFO and TIMESTAMP. It affects all messages of a stream, with its ACKNACKs and
HEARTBEATs.
"""

import random

from support.autopilot import ACKNACK, HEARTBEAT


class RoughLink:
    """A wrapper around another link.

    ``lost``, ``doubled`` and ``late`` are shares of the messages; a late message comes after the
    next one. ``counts`` has the numbers of such messages, by these names.
    """

    def __init__(self, link, seed, lost=0.2, doubled=0.1, late=0.1):
        self._link = link
        self._random = random.Random(seed)
        self._shares = {"lost": lost, "doubled": doubled, "late": late}
        self._late = {"out": [], "in": []}
        self.calm = False
        self.counts = dict.fromkeys(self._shares, 0)

    def fileno(self):
        return self._link.fileno()

    def close(self):
        self._link.close()

    def _happens(self, fault):
        happens = self._random.random() < self._shares[fault]
        self.counts[fault] += happens
        return happens

    def _through(self, message, way):
        """The messages that leave the link when this one enters."""
        late, self._late[way] = self._late[way], []
        if self.calm or not message[1] and message[4] not in (ACKNACK, HEARTBEAT):
            return [message, *late]
        if self._happens("lost"):
            return late
        if self._happens("late"):
            self._late[way] = [message]
            return late
        return [message, *late, *([message] if self._happens("doubled") else [])]

    def send(self, message):
        for copy in self._through(message, "out"):
            self._link.send(copy)

    def read(self):
        return [copy for message in self._link.read() for copy in self._through(message, "in")]
