"""A server that is only a selector; it records the calls of a transport."""

import selectors
import time

from support.lines import SECONDS

from uros.agent.clock import Clock
from uros.agent.transports.base import WARNING


class BareHost:
    """``messages`` are (peer, bytes); ``calls`` are (seconds, call), made by :meth:`fire`."""

    def __init__(self, clock=None):
        self.clock = clock or Clock()
        self.messages = []
        self.notes = []
        self.calls = []
        self.lines_lost = []  # the transports of the lost lines
        self.writing = {}
        self.time = 0
        self.answer = None  # called with (transport, peer, message)
        self._selector = selectors.DefaultSelector()

    def now(self):
        return self.time

    def unmatched(self, transport, peer, buf, view, length):
        self.messages.append((peer, bytes(view[:length])))
        if self.answer is not None:
            self.answer(transport, peer, bytes(view[:length]))

    def watch(self, fileno, ready, writing=False):
        self.unwatch(fileno)
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if writing else 0)
        self._selector.register(fileno, events, ready)
        self.writing[fileno] = writing

    def unwatch(self, fileno):
        assert fileno >= 0, "a descriptor must be unwatched before it is closed"
        if self.writing.pop(fileno, None) is not None:
            self._selector.unregister(fileno)

    def note(self, level, part, function, event, about):
        self.notes.append((level, f"{part} | {event} | {about}"))

    def wake_at(self, seconds, call):
        self.calls.append((seconds, call))

    def lost(self, transport):
        self.lines_lost.append(transport)

    def fire(self):
        """Make all scheduled calls, due or not."""
        calls, self.calls = self.calls, []
        for _, call in calls:
            call()

    def said(self):
        return "\n".join(text for _, text in self.notes)

    def warnings(self):
        return [text for level, text in self.notes if level <= WARNING]

    def turn(self, seconds=0.0):
        """Call the functions of ready descriptors; wait for them at most so long."""
        for key, _ in self._selector.select(seconds):
            if key.fd in self.writing:
                key.data()

    def until(self, done, awaited="event"):
        deadline = time.monotonic() + SECONDS
        while not done():
            assert time.monotonic() < deadline, f"{awaited} does not come; notes:\n{self.said()}"
            self.turn(0.01)

    def close(self):
        assert not self.writing, f"descriptors left: {self.writing}"
        self._selector.close()
