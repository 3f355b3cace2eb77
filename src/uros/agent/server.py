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
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol

from ..middleware.base import MiddlewareError
from ..middleware.wakeup_fd import WakeupFd
from ..ticks import ticks_diff
from .agent import Agent
from .objects.client import ProxyClient
from .observability.message_hooks import CLIENT
from .policy.time_budget import PAUSE
from .session.session import Session
from .transports.base import ServerTransport

# How long timers that are due may take in one turn, in seconds.
_MOST_DUE: Final = 0.005
# How long nothing is asked of a middleware that failed, and how often in a row it may before, where
# it fails to dispatch: there it may be one client's doing.
_AGAIN: Final = 0.1
_PATIENCE: Final = 10


class Attachment(Protocol):
    """What else lives in the server's thread, from its start to its end."""

    def open(self, server: Server) -> None:
        """Begin. Raises TransportError, and then the agent does not start."""

    def close(self) -> None:
        """End; also where it was not opened. Twice is once."""


class Server:
    """Runs an agent on transports until :meth:`stop`."""

    def __init__(self, agent: Agent, transports: list[ServerTransport]) -> None:
        self.agent = agent
        self.transports = transports
        self.attachments: list[Attachment] = []
        self._monotonic = agent.clock.monotonic
        self.started = self._monotonic()
        agent.middleware.batching = True
        self._selector = selectors.DefaultSelector()
        self._wake = WakeupFd()
        self._stopping = False
        self._calls: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._soon: deque[Callable[[], None]] = deque()
        # The time each client's timer is set to; other heap entries of it are stale.
        self._timers: dict[ProxyClient, float] = {}
        self._message_hooks = agent.message_hooks
        # A middleware that fails is asked again, but not at once.
        self._failures = 0
        self._tick_after = 0.0
        # For a watchdog.
        self.turns = 0
        self.asleep = False
        self.thread: int | None = None
        agent.time_budget.enabled = True
        agent.close_queue.schedule = lambda: self.wake_at(PAUSE, agent.close_queue.work)
        self.ready = threading.Event()

    # --- what transports call (see transport.base.Host) --------------------------

    def now(self) -> int:
        return self.agent.now()

    def unmatched(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        if self._message_hooks:
            self._message_hooks(transport, peer, CLIENT, view, length, 0)
        try:
            self.agent.unmatched(transport, peer, buf, view, length)
        except Exception as error:  # whatever it is, what else is in the burst counts
            self.agent.failed(error)

    def received(
        self, transport: ServerTransport, session: Session, buf: bytearray, view: memoryview,
        length: int, now: int,
    ) -> None:  # fmt: skip
        if self._message_hooks:
            peer = self.agent.place(session.key)[1]
            self._message_hooks(transport, peer, CLIENT, view, length, session.key)
        try:
            if session.receive(buf, view, length, now):
                self.agent.attended.add(session)
        except Exception as error:  # likewise
            self.agent.failed(error)
            self.agent.attended.add(session)

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        self.agent.gone(transport, peer)

    def lost(self, transport: ServerTransport) -> None:
        self.agent.line_loss.lost(transport)

    def has_client(self, transport: ServerTransport, peer: Any) -> bool:
        return self.agent.has_client(transport, peer)

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
        heapq.heappush(self._calls, (self._monotonic() + seconds, next(self._order), call))

    def soon(self, call: Callable[[], None]) -> None:
        """Call once, in the server's thread; from any thread."""
        self._soon.append(call)
        self._wake.set()

    def _woken(self) -> None:
        self._wake.clear()
        for _ in range(len(self._soon)):
            self._try(self._soon.popleft())

    def _try(self, call: Callable[..., object], *args: Any) -> None:
        """Call it; whatever goes wrong there, the boards go on."""
        try:
            call(*args)
        except Exception as error:
            self.agent.failed(error)

    # --- the loop -------------------------------------------------------------------

    def run(self) -> None:
        """Open everything, serve until :meth:`stop`, close everything.

        Raises TransportError where a transport cannot be opened; nothing stays
        open then.
        """
        middleware = self.agent.middleware
        try:
            self.watch(self._wake.fileno(), self._woken)
            self.agent.start(self.wake_at, self.transports)
            for transport in self.transports:
                transport.open(self)
            for attachment in self.attachments:
                attachment.open(self)
            self.watch(middleware.fileno(), self._dispatch)
            self.thread = threading.get_ident()
            self.ready.set()
            while not self._stopping:
                self._turn()
            self._hand_over()
        finally:
            self._stopping = True
            self.asleep = False
            self.ready.set()
            ends = [attachment.close for attachment in self.attachments]
            ends += [self.agent.close, self.agent.close_queue.finish, self._attend]
            ends += [transport.close for transport in self.transports]
            ends += [middleware.close, self._selector.close, self._wake.close]
            for end in ends:
                self._try(end)  # the others must be closed
                self.turns += 1
            self.thread = None

    def _hand_over(self) -> None:
        """Samples of boards are acknowledged that others have not been given yet: with ``--state``
        these sessions go on, and nobody else has them.
        """
        if self.agent.session_store is not None:
            self._dispatch()
            self._attend()

    def stop(self) -> None:
        """End :meth:`run` soon; from any thread or a signal handler."""
        self._stopping = True
        self._wake.set()

    @property
    def stopping(self) -> bool:
        """Whether :meth:`stop` was called."""
        return self._stopping

    def _deadline(self) -> float | None:
        """When the middleware wants to be called."""
        try:
            deadline = self.agent.middleware.next_deadline()
        except Exception as error:  # whatever it is, the boards go on
            self.agent.failed(error)
            deadline = self._tick_after = self._monotonic() + _AGAIN
        if deadline is not None and deadline < self._tick_after:
            deadline = self._tick_after
        return deadline

    def _dispatch(self) -> None:
        middleware = self.agent.middleware
        try:
            middleware.dispatch()
            self._failures = 0
        except Exception as error:  # likewise
            self.agent.failed(error)
            self._failures += 1
            if self._failures > _PATIENCE:
                fileno = middleware.fileno()
                self.unwatch(fileno)
                self.wake_at(_AGAIN, lambda: self.watch(fileno, self._dispatch))

    def _turn(self) -> None:
        """Sleep until something happens, and do it."""
        middleware, agent = self.agent.middleware, self.agent
        deadline = self._deadline()
        if self._calls and (deadline is None or self._calls[0][0] < deadline):
            deadline = self._calls[0][0]
        timeout = None if deadline is None else max(0.0, deadline - self._monotonic())
        self.asleep = True
        ready = self._selector.select(timeout)
        self.asleep = False
        self.turns += 1
        agent.close_queue.begin_turn()
        for key, _ in ready:
            try:
                key.data()
            except Exception as error:  # whatever it is, the other boards go on
                self.agent.failed(error)
        if deadline is not None:
            self._due(self._monotonic())
        try:
            middleware.flush()
            middleware.dispatch_local()
        except Exception as error:  # likewise
            self.agent.failed(error)
        if agent.attended:
            self._attend()
        if agent.budget.since > agent.budget.room:
            self._try(agent.budget.settle, self.now())

    def _due(self, now: float) -> None:
        while self._calls and self._calls[0][0] <= now:
            if self._monotonic() - now > _MOST_DUE:
                break  # others have their turn; the rest is due in the next
            self._try(heapq.heappop(self._calls)[2])
        if now < self._tick_after:
            return
        try:
            self.agent.middleware.tick()
        except Exception as error:  # likewise: boards are told the graph from there
            self._tick_after = now + _AGAIN
            if not isinstance(error, MiddlewareError):
                self.agent.failed(error)
            elif (times := self.agent.faults.times("tick")) is not None:
                self.agent.log.error("Middleware", "tick", "middleware error", f"{error}{times}")

    def _attend(self) -> None:
        """Acknowledge, send and set timers for the sessions that something happened to."""
        attended = self.agent.attended
        now = self.now()
        while attended:
            sessions = list(attended)
            attended.clear()
            if (keeper := self.agent.session_store) is not None:
                self._try(keeper.keep, sessions)  # what clients will be told, before they are
            for session in sessions:
                try:
                    session.finish()
                    self.agent.flush(session)
                    client = self.agent.clients.get(session.key)
                    if client is not None:
                        self._set_timer(client, now)
                except Exception as error:  # likewise
                    self.agent.failed(error)

    def _set_timer(self, client: ProxyClient, now: int) -> None:
        deadline = client.next_deadline()
        if deadline is None:
            self._timers.pop(client, None)
            return
        at = self._monotonic() + max(0, ticks_diff(deadline, now)) / 1000
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
