"""The agent's one thread: sockets, timers and middleware around an Agent.

The loop is plumbing. A transport drains its socket and hands messages to
sessions; those that want attention are then acknowledged, sent for and given
a timer, once a burst. Timers live in a heap; one that was moved is skipped
when its old time comes.
"""

from __future__ import annotations

import heapq
import itertools
import selectors
import threading
import time
from collections.abc import Callable
from typing import Any

from ..middleware.base import MiddlewareError
from ..middleware.wake import Wake
from ..transport.base import ServerTransport
from ..wire.streams import ticks_diff
from .agent import Agent, trace
from .client import Client
from .log import DEBUG
from .session import Session


class Server:
    """Runs an agent on transports until :meth:`stop`."""

    def __init__(self, agent: Agent, transports: list[ServerTransport]) -> None:
        self.agent = agent
        self.transports = transports
        agent.middleware.batching = True
        self._selector = selectors.DefaultSelector()
        self._wake = Wake()
        self._stopping = False
        self._calls: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        # The time each client's timer is set to; other heap entries of it are stale.
        self._timers: dict[Client, float] = {}
        self._trace = agent.log.level >= DEBUG
        self.ready = threading.Event()

    # --- what transports call (see transport.base.Host) --------------------------

    def now(self) -> int:
        return self.agent.now()

    def stray(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        if self._trace:
            trace(self.agent.log, transport, "recv", view, length, 0)
        self.agent.stray(transport, peer, buf, view, length)

    def received(
        self, transport: ServerTransport, session: Session, buf: bytearray, view: memoryview,
        length: int, now: int,
    ) -> None:  # fmt: skip
        if self._trace:
            trace(self.agent.log, transport, "recv", view, length, session.key)
        if session.receive(buf, view, length, now):
            self.agent.attended.add(session)

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        self.agent.gone(transport, peer)

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if writing else 0)
        try:
            key = self._selector.get_key(fileno)
        except KeyError:
            self._selector.register(fileno, events, ready)
            return
        if key.events != events:
            self._selector.modify(fileno, events, ready)

    def unwatch(self, fileno: int) -> None:
        try:
            self._selector.unregister(fileno)
        except KeyError:
            pass

    def note(self, level: int, part: str, function: str, what: str, about: str) -> None:
        self.agent.log(level, part, function, what, about)

    def wake_at(self, seconds: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._calls, (time.monotonic() + seconds, next(self._order), call))

    # --- the loop -------------------------------------------------------------------

    def run(self) -> None:
        """Open everything, serve until :meth:`stop`, close everything.

        Raises TransportError where a transport cannot be opened; nothing stays
        open then.
        """
        middleware = self.agent.middleware
        try:
            self.watch(self._wake.fileno(), self._wake.clear)
            for transport in self.transports:
                transport.open(self)
            self.watch(middleware.fileno(), middleware.dispatch)
            self.ready.set()
            while not self._stopping:
                self._turn()
        finally:
            self.ready.set()
            self.agent.close()
            self._attend()
            for transport in self.transports:
                transport.close()
            middleware.close()
            self._selector.close()
            self._wake.close()

    def stop(self) -> None:
        """End :meth:`run` soon; from any thread or a signal handler."""
        self._stopping = True
        self._wake.set()

    def _turn(self) -> None:
        """Sleep until something happens, and do it."""
        middleware = self.agent.middleware
        deadline = middleware.next_deadline()
        if self._calls and (deadline is None or self._calls[0][0] < deadline):
            deadline = self._calls[0][0]
        timeout = None if deadline is None else max(0.0, deadline - time.monotonic())
        for key, _ in self._selector.select(timeout):
            try:
                key.data()
            except Exception as error:  # whatever it is, the other boards go on
                self._report(error)
        if deadline is not None:
            self._due(time.monotonic())
        try:
            middleware.flush()
            middleware.dispatch_local()
        except Exception as error:  # likewise
            self._report(error)
        if self.agent.attended:
            self._attend()

    def _due(self, now: float) -> None:
        while self._calls and self._calls[0][0] <= now:
            call = heapq.heappop(self._calls)[2]
            try:
                call()
            except Exception as error:  # likewise
                self._report(error)
        try:
            self.agent.middleware.tick()
        except MiddlewareError as error:
            self.agent.log.error("Middleware", "tick", "middleware error", str(error))
        except Exception as error:  # likewise: boards are told the graph from there
            self._report(error)

    def _report(self, error: Exception) -> None:
        kept = self.agent.faults.admit(f"internal {type(error).__name__}")
        if kept:
            frame = error.__traceback__
            while frame is not None and frame.tb_next is not None:
                frame = frame.tb_next
            where = f"{frame.tb_frame.f_code.co_filename}:{frame.tb_lineno}" if frame else "?"
            self.agent.log.error(
                "Server", "run", "internal error",
                f"{type(error).__name__}: {error} at {where}"
                " (this is a fault of uros: please report it)",
            )  # fmt: skip

    def _attend(self) -> None:
        """Acknowledge, send and set timers for the sessions that something happened to."""
        attended = self.agent.attended
        now = self.now()
        while attended:
            session = attended.pop()
            try:
                session.finish(now)
                self.agent.flush(session)
                client = self.agent.clients.get(session.key)
                if client is not None:
                    self._set_timer(client, now)
            except Exception as error:  # likewise
                self._report(error)

    def _set_timer(self, client: Client, now: int) -> None:
        deadline = client.next_deadline()
        if deadline is None:
            self._timers.pop(client, None)
            return
        at = time.monotonic() + max(0, ticks_diff(deadline, now)) / 1000
        known = self._timers.get(client)
        if known is not None and known <= at:
            return  # it will be looked at before that, and set anew
        self._timers[client] = at

        def fire() -> None:
            if self._timers.get(client) != at:
                return
            del self._timers[client]
            if self.agent.clients.get(client.key) is client:
                self.agent.attended.add(client.session)  # even if poll fails
                client.poll(self.now())

        heapq.heappush(self._calls, (at, next(self._order), fire))
