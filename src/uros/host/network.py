"""A program's participant in a domain: a hidden node, its graph, and their event loop.

Everything runs in the calling thread, within :meth:`Network.spin` and the methods that call it.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Final, NamedTuple

from .. import names
from ..middleware import open_middleware
from ..middleware.base import MiddlewareError, Reader
from ..middleware.graph import (
    undiscovered_endpoints,
    with_missed_discovery_info,
    without_discovery_info,
    without_endpoints,
)
from ..qos import HistoryPolicy, QoSProfile
from .graph_queries import Graph
from .interrupt import Interrupt

DISCOVERY_SECONDS: Final = 4.0
# Seconds without changes after which the graph is complete.
_QUIET: Final = 0.2
# The least seconds after joining: participants that are busy answer late.
_SOONEST: Final = 0.3
# The same while there is no other participant: we repeat our announcement after 0.1, 0.2 and
# 0.5 s, since multicast may be lost, and wait for the answers to the last of these.
_ALONE: Final = 0.6
# Seconds without changes while a participant has no endpoints, because Fast DDS announces them
# again a second after discovery if the first announcement was lost.
_SLOW: Final = 1.25
# Seconds without changes after which missing discovery info is read again.
_ASK_AGAIN: Final = 0.1
# Most samples taken at once, and before others have their turn.
_BATCH: Final = 64
_TURN: Final = 1024
# Seconds for which samples are delivered before those that came meanwhile are taken. They wait
# here, where what has no room is counted: a reader of DDS drops the oldest in silence.
_SLICE: Final = 0.005
# The most samples that wait here, and the most of their octets.
_MOST_WAITING: Final = 10_000
_MOST_OCTETS: Final = 1 << 26


class Received(NamedTuple):
    """A sample with its encapsulation header, and the times of writing and taking (Unix ns).

    The time of writing is 0 where its writer does not give it. ``writer`` is the writer's GUID,
    empty where the middleware does not tell it.
    """

    cdr: bytes
    source_ns: int
    received_ns: int
    writer: bytes = b""


def complete_at(joined_at: float, changed_at: float, alone: bool, silent: bool) -> float:
    """Return when the graph is complete unless something changes before.

    Args:
        joined_at: When the domain was joined, in seconds.
        changed_at: When the graph changed last, in seconds.
        alone: Whether there is no other participant.
        silent: Whether a participant has no endpoints.
    """
    if alone:
        return max(joined_at + _ALONE, changed_at + _QUIET)
    return max(joined_at + _SOONEST, changed_at + (_SLOW if silent else _QUIET))


class Network:
    """A node in ``domain``, and the graph that it discovers.

    Close it, or use ``with``.

    Args:
        domain: The domain.
        middleware: What :func:`uros.middleware.open_middleware` calls it.
        node_name: The node's name; by default ``_uros_<pid>``, which is hidden.

    Attributes:
        overflowed: Whether the history of a subscription was full, so that newer samples may have
            replaced others, which :meth:`lost` does not count.

    Raises:
        MiddlewareError: The domain cannot be joined, or the middleware does not know its graph.
    """

    def __init__(self, domain: int, middleware: str = "auto", node_name: str = "") -> None:
        opened = open_middleware(middleware)
        self.domain = domain
        self._middleware = opened
        self._interrupt = Interrupt()
        self._samples: deque[tuple[Callable[[Received], None], Received]] = deque()
        self._octets = 0  # of these samples
        self._skipped = 0
        self.overflowed = False
        self._readers: list[Reader] = []
        # What takes the rest of the samples of a reader that had more than a batch.
        self._unread: dict[Callable[[], None], None] = {}
        try:
            self.node = opened.create_node(domain, "/", node_name or f"_uros_{os.getpid()}")
            self._joined_at = self._changed_at = time.monotonic()
            discovery = opened.graph(domain, self._on_change, paced=False)
            if discovery is None:
                raise MiddlewareError(f"the {middleware} middleware does not know its graph")
            self._discovery = discovery
        except BaseException:
            opened.close()
            raise
        self.graph = Graph(self._discovery)

    def _on_change(self) -> None:
        self._changed_at = time.monotonic()

    @property
    def changed_at(self) -> float:
        """When the graph has changed last (``time.monotonic``)."""
        return self._changed_at

    @property
    def alone(self) -> bool:
        """Whether no other participant was found in the domain."""
        return len(self._discovery.participants) <= 1

    def listen(
        self, topic: str, type_name: str, qos: QoSProfile, on_sample: Callable[[Received], None]
    ) -> Callable[[], None]:
        """Subscribe to a topic; the type's definition is not needed.

        Args:
            topic: ROS name.
            type_name: ROS name.
            qos: The subscription's profile.
            on_sample: Called by :meth:`spin` for each sample.

        Returns:
            A function that ends the subscription.

        Raises:
            MiddlewareError: The subscription cannot be created.
        """
        ended = False
        # With a depth of 1, the latest sample alone is wanted.
        is_queue = qos.history == HistoryPolicy.KEEP_LAST and qos.depth > 1

        def on_ready() -> None:
            taken = 0
            while taken < _TURN:
                samples = reader.take_stamped(_BATCH)
                self._keep(samples, deliver)
                taken += len(samples)
                if len(samples) < _BATCH:
                    break
            else:
                self._unread[on_ready] = None  # deliver these samples first
            if is_queue and taken >= qos.depth and not reader.counts_replaced:
                self.overflowed = True

        def deliver(received: Received) -> None:
            if not ended:
                on_sample(received)

        def end() -> None:
            nonlocal ended
            if not ended:
                ended = True
                self._readers.remove(reader)
                self._skipped += reader.lost()
                reader.close()

        reader = self.node.create_reader(
            names.topic_to_dds(topic), names.type_to_dds(type_name), qos, on_ready
        )
        self._readers.append(reader)
        return end

    def _keep(
        self, samples: list[tuple[bytes, int, bytes]], deliver: Callable[[Received], None]
    ) -> None:
        """Keep samples until they are delivered, and count those for which there is no room."""
        now = time.time_ns()
        for cdr, source_ns, writer in samples:
            if len(self._samples) >= _MOST_WAITING or self._octets >= _MOST_OCTETS:
                self._skipped += 1
                continue
            self._octets += len(cdr)
            self._samples.append((deliver, Received(cdr, source_ns, now, writer)))

    def lost(self) -> int:
        """Return how many samples of all subscriptions were lost until now.

        Those are samples that the network lost, and those that came too fast to be delivered, as
        far as the middleware counts them.
        """
        return self._skipped + sum(reader.lost() for reader in self._readers)

    def spin(self, done: Callable[[], bool], seconds: float | None = None) -> bool:
        """Run the event loop until ``done()``, which is called after every event.

        Args:
            done: Returns whether to stop.
            seconds: The timeout; None has no limit.

        Returns:
            False after the timeout.
        """
        end = None if seconds is None else time.monotonic() + seconds
        with self._interrupt.watched():
            while True:
                # The callback runs here and not where samples are taken: it may block on a pipe,
                # and Ctrl-C must be able to end it.
                self._deliver()
                if done():
                    return True
                now = time.monotonic()
                if end is not None and now >= end:
                    return False
                if self._samples or self._unread:
                    self._work(0.0)
                    continue
                due = [at for at in (end, self._middleware.next_deadline()) if at is not None]
                self._work(max(0.0, min(due) - now) if due else None)

    def _deliver(self) -> None:
        """Deliver the samples that wait, for some milliseconds at most."""
        until = time.monotonic() + _SLICE
        while self._samples:
            deliver, received = self._samples.popleft()
            self._octets -= len(received.cdr)
            deliver(received)
            if time.monotonic() > until:
                return

    def _work(self, seconds: float | None) -> None:
        """Wait for an event, ``seconds`` at most, and handle it."""
        self._interrupt.hold()
        try:
            if self._interrupt.wait(self._middleware.fileno(), seconds):
                self._middleware.dispatch()
            unread, self._unread = self._unread, {}
            for take in unread:
                take()
            self._middleware.tick()
        finally:
            self._interrupt.release()

    def settle(self, seconds: float = DISCOVERY_SECONDS) -> None:
        """Run discovery until the graph is complete, for ``seconds`` at most.

        It is complete when nothing has changed for a while, every ROS participant has announced
        its nodes, and all their endpoints are discovered.
        """
        end = time.monotonic() + seconds
        requested: set[bytes] = set()
        while (now := time.monotonic()) < end:
            check_at = end
            missing = with_missed_discovery_info(self._discovery) - requested
            if missing:
                check_at = self._changed_at + _ASK_AGAIN
                if now >= check_at:
                    requested |= missing
                    self._discovery.reread_discovery_info()
                    continue
            elif not (
                without_discovery_info(self._discovery) or undiscovered_endpoints(self._discovery)
            ):
                check_at = complete_at(
                    self._joined_at,
                    self._changed_at,
                    self.alone,
                    bool(without_endpoints(self._discovery)),
                )
                if now >= check_at:
                    return
            self._wait_for_change(min(check_at, end) - now)

    def _wait_for_change(self, seconds: float) -> None:
        before = self._changed_at
        self.spin(lambda: self._changed_at != before, seconds)

    def close(self) -> None:
        """Leave the domain; idempotent."""
        self._middleware.close()

    def __enter__(self) -> Network:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
