"""A link to an agent that loses, doubles and delays messages, each way.

What the C library asks again only after seconds, or never, passes: CREATE_CLIENT, DELETE, GET_INFO
and TIMESTAMP. All that belongs to a stream does not, its ACKNACKs and HEARTBEATs included.
"""

import random

from support.autopilot import ACKNACK, HEARTBEAT


class RoughLink:
    """Around another link. ``lost``, ``doubled`` and ``late`` are shares of the messages; a late
    one comes behind the next. ``counts`` is what happened, by these names."""

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

    def _happens(self, what):
        happens = self._random.random() < self._shares[what]
        self.counts[what] += happens
        return happens

    def _through(self, message, way):
        """What comes out of the link when this goes in."""
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
        for it in self._through(message, "out"):
            self._link.send(it)

    def read(self):
        return [it for message in self._link.read() for it in self._through(message, "in")]
