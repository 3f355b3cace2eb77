"""Boards and an agent of uros on an unreliable network, in one thread and in simulated time.

    with Wire(seed, loss=0.3, twice=0.2, late_ms=50) as wire:
        node = wire.node("talker")
        wire.until(lambda: node.state == AGENT_CONNECTED)

Nothing sleeps: time advances from one event to the next. The agent is the real one, on the memory
middleware; this module takes the place of the server's loop.
"""

import heapq
import io
import random

from support.board import FakeClock
from uros.agent.agent import Agent
from uros.agent.clock import Clock
from uros.agent.log import Log
from uros.agent.transports.base import ServerTransport
from uros.client import AGENT_CONNECTED, Node
from uros.middleware.memory import MemoryMiddleware
from uros.ticks import TIME_MASK, ticks_diff

STEP_MS = 10


class _Place(ServerTransport):
    """The agent's end of the network; a peer is the number of its board."""

    name = "WireAgent"
    kind = "WIRE"

    def __init__(self, wire):
        super().__init__()
        self._wire = wire

    def open(self, host):
        pass

    def send(self, peer, datagram):
        self._wire.carry(bytes(datagram), self._wire.boards[peer].hear)

    def address(self, peer):
        return f"board {peer}"

    def close(self):
        pass


class BoardEnd:
    """The transport of a board."""

    def __init__(self, wire, number, mtu):
        self.mtu = mtu
        self.inbox = []
        self.is_open = False
        self._wire = wire
        self._number = number

    def open(self):
        self.is_open = True

    def close(self):
        self.is_open = False
        self.inbox.clear()

    def hear(self, datagram):
        if self.is_open:
            self.inbox.append(datagram)

    def send(self, message, size):
        number = self._number
        datagram = bytes(memoryview(message)[:size])
        self._wire.carry(datagram, lambda received: self._wire.agent_hears(number, received))

    def receive(self, timeout_ms):
        self._wire.advance(timeout_ms, lambda: bool(self.inbox))
        return self.inbox.pop(0) if self.inbox else None


class Wire:
    """The network with its boards and its agent.

    ``loss`` and ``twice`` are the probabilities that a datagram is lost or duplicated. Its latency
    is ``way_ms`` plus a random part of ``late_ms``, so that datagrams overtake each other.
    """

    def __init__(self, seed=0, loss=0.0, twice=0.0, late_ms=0.0, way_ms=0.1):
        self.clock = FakeClock(seed * 12345)
        self.loss = loss
        self.twice = twice
        self.late_ms = late_ms
        self.way_ms = way_ms
        self.random = random.Random(seed)
        self.boards = {}
        self.nodes = []
        self.carried = self.lost = self.doubled = 0
        self._events = []
        self._order = 0
        self.start_agent()

    def start_agent(self):
        """Start an agent without sessions in place of the one before, which is not closed."""
        self.said = io.StringIO()
        self.middleware = MemoryMiddleware()
        clock = Clock(time_ns=self.epoch_ns)
        self.agent = Agent(self.middleware, Log(4, self.said), clock=clock)
        self.agent.now = lambda: self.clock.t // 1000 & TIME_MASK
        self.place = _Place(self)

    def kill_agent(self):
        """End the agent like a killed process; datagrams in flight to it are lost."""
        self.middleware.close()
        self.agent = None

    def epoch_ns(self):
        return (1700000000 * 1000000 + self.clock.t) * 1000

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.agent is not None:
            self.agent.close()
            self.middleware.close()
            assert "internal error" not in self.said.getvalue(), self.said.getvalue()

    def node(self, name, mtu=512, **options):
        """Create a board with one node."""
        number = len(self.boards) + 1
        self.boards[number] = BoardEnd(self, number, mtu)
        options.setdefault("silence_ms", 20000)
        node = Node(name, self.boards[number], key=number, clock=self.clock, **options)
        self.nodes.append(node)
        return node

    # --- the network ----------------------------------------------------------------------

    def carry(self, datagram, arrive):
        """Send a datagram: lose it, or schedule the arrival of one or two copies."""
        self.carried += 1
        if self.random.random() < self.loss:
            self.lost += 1
            return
        copies = 1
        if self.random.random() < self.twice:
            self.doubled += 1
            copies = 2
        for _ in range(copies):
            self._order += 1
            late = self.way_ms + self.random.random() * self.late_ms
            at = self.clock.t + int(late * 1000)
            heapq.heappush(self._events, (at, self._order, arrive, datagram))

    def agent_hears(self, number, datagram):
        if self.agent is not None:
            buf = bytearray(datagram)
            view = memoryview(buf)
            self.place.deliver(self, number, buf, view, len(buf), self.agent.now())
            self.settle()

    # The methods of a server that a transport calls.

    def now(self):
        return self.agent.now()

    def received(self, transport, session, buf, view, length, now):
        if session.receive(buf, view, length, now):
            self.agent.attend(session)

    def unmatched(self, transport, peer, buf, view, length):
        self.agent.unmatched(transport, peer, buf, view, length)

    def settle(self):
        """Do the work of the server's loop after a burst of datagrams."""
        self.middleware.dispatch()
        while self.agent.attended:
            session = self.agent.attended.pop()
            session.finish()
            self.agent.flush(session)

    def _timers(self):
        """Run the agent's timers that are due; microseconds until the next one."""
        soonest = STEP_MS * 1000
        if self.agent is None:
            return soonest
        now = self.agent.now()
        for client in list(self.agent.clients.values()):
            deadline = client.next_deadline()
            if deadline is not None and ticks_diff(deadline, now) <= 0:
                client.poll(now)
                self.agent.attend(client.session)
                deadline = client.next_deadline()
            if deadline is not None:
                soonest = min(soonest, max(1, ticks_diff(deadline, now)) * 1000)
        self.settle()
        return soonest

    # --- time -----------------------------------------------------------------------------

    def advance(self, ms, done=lambda: False):
        """Process events for ``ms``, or until ``done()``."""
        end = self.clock.t + ms * 1000
        while True:
            while self._events and self._events[0][0] <= self.clock.t:
                _, _, arrive, datagram = heapq.heappop(self._events)
                arrive(datagram)
            wait = self._timers()
            if done() or self.clock.t >= end:
                return
            at = min(end, self.clock.t + wait)
            if self._events:
                at = min(at, self._events[0][0])
            self.clock.t = max(at, self.clock.t + 1)

    def run(self, ms):
        """Spin all nodes for ``ms``."""
        self.until(lambda: False, ms, None)

    def until(self, done, ms=30000, what="it takes too long"):
        """Spin all nodes until ``done()``; AssertionError with ``what`` after ``ms``."""
        end = self.clock.t + ms * 1000
        while not done():
            if self.clock.t >= end:
                assert what is None, what
                return
            for node in self.nodes:
                while node.spin_once(0):
                    pass
            self.advance(STEP_MS, lambda: any(board.inbox for board in self.boards.values()))

    def connect(self):
        """Spin until all nodes are connected and no earlier datagram is in flight."""

        def connected():
            return len(self.agent.clients) == len(self.nodes) and all(
                node.state == AGENT_CONNECTED for node in self.nodes
            )

        for _ in range(20):
            self.until(connected, what=[node.connection.reason for node in self.nodes])
            before = [node.connection.connections for node in self.nodes]
            self.run(2 * int(self.late_ms + self.way_ms) + 100)
            if before == [node.connection.connections for node in self.nodes] and connected():
                return
        raise AssertionError("the nodes do not stay connected")
