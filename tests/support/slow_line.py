"""A serial line between two terminals, limited to its baud rate.

A UART sends an octet as ten bits, 8N1: a start bit, eight of data, a stop bit. So 921,600 baud are
92,160 octets a second in each direction.
"""

import collections
import os
import select
import threading
import time
import tty

BITS = 10  # an octet, 8N1
# The buffer of a bridge between USB and a UART (an FT2232H, a CP2102N), each way. A thread that
# wakes late finds the octets there that the line would have carried meanwhile.
FIFO = 1024
_STEP = 64  # octets that arrive together, as in a USB packet
_NAP = 0.002


class _Way:
    """One direction. ``carried`` counts the octets that have arrived."""

    def __init__(self, source, target, seconds):
        self.source = source
        self.target = target
        self.carried = 0
        self._octet = seconds
        self._free = 0.0  # when the last accepted octet has been transmitted
        self._coming = collections.deque()  # (time of arrival, octets)
        self._held = 0

    def take(self, now):
        while self._held < FIFO:
            try:
                octets = os.read(self.source, min(_STEP, FIFO - self._held))
            except BlockingIOError:
                return
            self._free = max(self._free, now) + len(octets) * self._octet
            self._coming.append((self._free, octets))
            self._held += len(octets)

    def give(self, now):
        while self._coming and self._coming[0][0] <= now:
            when, octets = self._coming[0]
            try:
                count = os.write(self.target, octets)
            except BlockingIOError:
                return
            self.carried += count
            self._held -= count
            self._coming.popleft()
            if count < len(octets):
                self._coming.appendleft((when, octets[count:]))
                return

    def wait(self, now):
        return max(0.0, self._coming[0][0] - now) if self._coming else None


class SlowLine:
    """A context that carries octets between a board's terminal ``device`` and the agent's ``path``.

    ``up`` is the direction from the board, ``down`` the direction to it. ``capacity`` is the limit
    of each direction in octets a second.
    """

    def __init__(self, device, baud):
        self.capacity = baud / BITS
        self.error = None
        self._fds = [os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)]
        self._fds += os.openpty()
        theirs, ours, agents = self._fds
        for fd in (theirs, agents):
            tty.setraw(fd)
        os.set_blocking(ours, False)
        self.path = os.ttyname(agents)
        self.up = _Way(theirs, ours, 1 / self.capacity)
        self.down = _Way(ours, theirs, 1 / self.capacity)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="slow line", daemon=True)

    def _run(self):
        ways = (self.up, self.down)
        try:
            while not self._ended.is_set():
                now = time.monotonic()
                for way in ways:
                    way.take(now)
                    way.give(now)
                nap = min(
                    [
                        _NAP,
                        *(
                            wait_s
                            for wait_s in (way.wait(now) for way in ways)
                            if wait_s is not None
                        ),
                    ]
                )
                idle = [way.source for way in ways if not way._held]
                select.select(idle, [], [], nap)
        except OSError as error:
            self.error = error

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        for fd in self._fds:
            os.close(fd)
