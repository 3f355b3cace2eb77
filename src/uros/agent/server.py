"""Runs an agent: one thread with its sockets, timers and middleware.

In each turn of its loop the thread waits for events. A transport drains a socket that is ready and
passes the messages to sessions. After such a burst the loop acknowledges, sends and sets timers for
the sessions that had something to do. Timers are in a heap; the former entry of a timer that was
moved is skipped when its time comes.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol

from .. import poller
from ..middleware.base import MiddlewareError
from ..middleware.wakeup_fd import WakeupFd
from ..ticks import ticks_diff
from .agent import Agent
from .objects.client import ProxyClient
from .observability.message_hooks import CLIENT
from .policy.time_budget import PAUSE
from .session.session import Session
from .transports.base import ServerTransport

# How long timers that are due may take in one turn of the loop, in seconds.
_MOST_DUE: Final = 0.005
# Seconds for which a middleware that failed is not called.
_AGAIN: Final = 0.1
# How often in a row dispatch() may fail before it is not called, because one client may be the
# cause.
_PATIENCE: Final = 10


class Attachment(Protocol):
    """What runs in the server's thread besides the agent, such as the status socket."""

    def open(self, server: Server) -> None:
        """Start, as the server does.

        Raises:
            TransportError: It cannot; then the agent does not start.
        """

    def close(self) -> None:
        """End, also if it was not opened. Idempotent."""


class Server:
    """Runs an agent on transports until :meth:`stop`.

    Attributes:
        clock: The agent's clock.
        attachments: What else to open and close with the server.
        started: When it was created, in seconds of the agent's monotonic clock.
        turns: How many turns the loop has had; for a watchdog.
        asleep: Whether the loop waits for an event; for a watchdog.
        thread: The ident of the thread of :meth:`run`, or None.
        ready: Set when everything is open, and when :meth:`run` ends.
        config_file: The absolute path of the configuration file; "" without one.
        troubles: Functions that return what is wrong with a part of the agent; "" if nothing is.

    Args:
        agent: The agent.
        transports: What it listens on.
    """

    def __init__(self, agent: Agent, transports: list[ServerTransport]) -> None:
        self.agent = agent
        self.transports = transports
        self.attachments: list[Attachment] = []
        self.clock = agent.clock
        self._monotonic = agent.clock.monotonic
        self.started = self._monotonic()
        agent.middleware.batching = True
        self._engines = agent.middleware.engines
        self._poller = poller.create()
        self._poll = self._poller.poll
        self._busy_poll = poller.BusyPoll(self._poll, self._monotonic)
        self._timer = poller.DeadlineTimer(self._monotonic)
        self._wake = WakeupFd()
        self._stopping = False
        self._calls: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._soon: deque[Callable[[], None]] = deque()
        # The time each client's timer is set to; other heap entries of it are stale.
        self._timers: dict[ProxyClient, float] = {}
        self._message_hooks = agent.message_hooks
        # What transports call, see transports.base.Host: milliseconds modulo 2^30.
        self.now: Callable[[], int] = agent.now
        # A middleware that fails is called again, but not at once.
        self._failures = 0
        self._tick_after = 0.0
        self.turns = 0
        self.asleep = False
        self.thread: int | None = None
        agent.time_budget.enabled = True
        agent.close_queue.schedule = lambda: self.wake_at(PAUSE, agent.close_queue.work)
        self.ready = threading.Event()
        self.config_file = ""
        self.troubles: list[Callable[[], str]] = []

    # --- what transports call (see transports.base.Host) -------------------------

    def unmatched(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        """Handle a message that belongs to no session of this peer."""
        if self._message_hooks:
            self._message_hooks(transport, peer, CLIENT, view, length, 0)
        try:
            self.agent.unmatched(transport, peer, buf, view, length)
        except Exception as error:  # the rest of the burst must be handled
            self.agent.failed(error)

    def received(
        self, transport: ServerTransport, session: Session, buf: bytearray, view: memoryview,
        length: int, now: int,
    ) -> None:  # fmt: skip
        """Handle a message of a session."""
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
        """Delete the clients of a peer whose connection was closed."""
        self.agent.gone(transport, peer)

    def lost(self, transport: ServerTransport) -> None:
        """Note that a line of a transport was lost; its clients have some seconds to come back."""
        self.agent.line_loss.lost(transport)

    def has_client(self, transport: ServerTransport, peer: Any) -> bool:
        """Return whether a client has this address."""
        return self.agent.has_client(transport, peer)

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """Call ``ready`` when a descriptor can be read, or written if ``writing``."""
        self._poller.watch(fileno, ready, writing)

    def unwatch(self, fileno: int) -> None:
        """Stop watching a descriptor. Idempotent."""
        self._poller.unwatch(fileno)

    def note(self, level: int, part: str, function: str, event: str, about: str) -> None:
        """Log a line."""
        self.agent.log(level, part, function, event, about)

    def wake_at(self, seconds: float, call: Callable[[], None]) -> None:
        """Call ``call`` once, ``seconds`` from now."""
        heapq.heappush(self._calls, (self._monotonic() + seconds, next(self._order), call))

    def soon(self, call: Callable[[], None]) -> None:
        """Call ``call`` once in the server's thread. May be used from any thread."""
        self._soon.append(call)
        self._wake.set()

    def _woken(self) -> None:
        self._wake.clear()
        for _ in range(len(self._soon)):
            self._try(self._soon.popleft())

    def _try(self, call: Callable[..., object], *args: Any) -> None:
        """Call a function and log its errors, so that the loop continues."""
        try:
            call(*args)
        except Exception as error:
            self.agent.failed(error)

    # --- the loop -------------------------------------------------------------------

    def run(self) -> None:
        """Open everything, serve until :meth:`stop`, and close everything.

        Raises:
            TransportError: A transport cannot be opened; nothing stays open then.
        """
        middleware = self.agent.middleware
        try:
            self.watch(self._wake.fileno(), self._woken)
            if self._timer.fd >= 0:
                self.watch(self._timer.fd, self._timer.clear)
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
            self._deliver_acknowledged()
        finally:
            self._stopping = True
            self.asleep = False
            self.ready.set()
            ends = [attachment.close for attachment in self.attachments]
            ends += [self.agent.close, self.agent.close_queue.finish, self._attend]
            ends += [transport.close for transport in self.transports]
            ends += [middleware.close, self._poller.close, self._wake.close, self._timer.close]
            for end in ends:
                self._try(end)  # a failure must not keep the others open
                self.turns += 1
            self.thread = None

    def _deliver_acknowledged(self) -> None:
        """Dispatch samples that are acknowledged already, before shutdown.

        With ``--state`` the sessions continue after it, and boards do not send these samples again.
        """
        if self.agent.session_store is not None:
            self._dispatch()
            self._attend()

    def stop(self) -> None:
        """End :meth:`run` soon. May be used from any thread and from a signal handler."""
        self._stopping = True
        self._wake.set()

    @property
    def middleware_fails(self) -> bool:
        """Whether the middleware raises errors again and again."""
        return self._failures > _PATIENCE

    @property
    def stopping(self) -> bool:
        """Whether :meth:`stop` was called."""
        return self._stopping

    def _deadline(self) -> float | None:
        """Return when a timer or the middleware is due, or None."""
        deadline = None
        try:
            for engine in self._engines:
                at = engine.next_deadline()
                if at is not None and (deadline is None or at < deadline):
                    deadline = at
        except Exception as error:  # the loop must continue to serve boards
            self.agent.failed(error)
            deadline = self._tick_after = self._monotonic() + _AGAIN
        if deadline is not None and deadline < self._tick_after:
            deadline = self._tick_after
        if self._calls and (deadline is None or self._calls[0][0] < deadline):
            deadline = self._calls[0][0]
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
        """Wait for events and timers, and handle them."""
        agent, timer, busy_poll = self.agent, self._timer, self._busy_poll
        deadline = self._deadline()
        timeout = None
        if deadline is not None and deadline < timer.at:
            timeout = timer.wait_until(deadline)
        self.asleep = True
        ready = busy_poll.poll(timeout) if busy_poll.expects else self._poll(timeout)
        self.asleep = False
        self.turns += 1
        if agent.close_queue.spent:
            agent.close_queue.begin_turn()
        for call in ready:
            try:
                call()
            except Exception as error:  # the other boards must be served
                self.agent.failed(error)
        # While the timer is set to the deadline or an earlier time, that has not come.
        if deadline is not None and deadline < timer.at and (now := self._monotonic()) >= deadline:
            self._due(now)
        for engine in self._engines:
            try:
                try:
                    engine.flush()
                finally:
                    engine.dispatch_local()
            except Exception as error:  # likewise
                self.agent.failed(error)
        if agent.attended:
            self._attend()
        if agent.budget.since > agent.budget.room:
            self._try(agent.budget.settle, self.now())

    def _due(self, now: float) -> None:
        while self._calls and self._calls[0][0] <= now:
            if self._monotonic() - now > _MOST_DUE:
                break  # sockets are served first; the other timers follow in the next turn
            self._try(heapq.heappop(self._calls)[2])
        if now < self._tick_after:
            return
        try:
            self.agent.middleware.tick()
        except Exception as error:  # likewise; tick() also sends the graph to boards
            self._tick_after = now + _AGAIN
            if not isinstance(error, MiddlewareError):
                self.agent.failed(error)
            elif (times := self.agent.faults.times("tick")) is not None:
                self.agent.log.error("Middleware", "tick", "middleware error", f"{error}{times}")

    def _attend(self) -> None:
        """Acknowledge, send and set timers for the sessions that had messages or events."""
        attended = self.agent.attended
        while attended:
            sessions = list(attended)
            attended.clear()
            if (store := self.agent.session_store) is not None:
                self._try(store.keep, sessions)  # before anything is acknowledged or sent
            for session in sessions:
                try:
                    session.finish()
                    self.agent.flush(session)
                    if session.delivered:
                        session.delivered = False
                        self._busy_poll.expect_answer()
                    client = self.agent.clients.get(session.key)
                    if client is not None:
                        self._set_timer(client)
                except Exception as error:  # likewise
                    self.agent.failed(error)

    def _set_timer(self, client: ProxyClient) -> None:
        deadline = client.next_deadline()
        if deadline is None:
            self._timers.pop(client, None)
            return
        at = self._monotonic() + max(0, ticks_diff(deadline, self.now())) / 1000
        timer_before = self._timers.get(client)
        if timer_before is not None and timer_before <= at:
            return  # it fires before that, and is set again then
        self._timers[client] = at

        def fire() -> None:
            if self._timers.get(client) != at:
                return
            del self._timers[client]
            if self.agent.clients.get(client.key) is client:
                self.agent.attended.add(client.session)  # even if poll fails
                client.poll(self.now())

        heapq.heappush(self._calls, (at, next(self._order), fire))
