"""The contract of :mod:`uros.middleware.base` on RTPS, without a DDS library."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable

from ... import poller
from ..base import Middleware, check_domain
from ..discovery_info.node_entry import NodeEntry
from ..domains import check_loopback, check_number_joined
from ..environment import discovery_range
from ..wakeup_fd import WakeupFd
from . import network
from .domain import RtpsDomain
from .endpoints import RtpsReader
from .graph import RtpsGraph
from .node import RtpsNode


class RtpsMiddleware(Middleware):
    """Nodes on RTPS, configured by this process's environment.

    A domain is joined by its first node, and left with the middleware. There is no thread: the
    caller's selector wakes up for :meth:`fileno`, and calls :meth:`tick` in time.

    Args:
        announces_nodes: Whether it has nodes of its own. Otherwise it carries the services of nodes
            that another middleware of this process announces.

    Attributes:
        unsent: The domains that have something to send.

    Raises:
        MiddlewareError: ROS_AUTOMATIC_DISCOVERY_RANGE has a value that does not exist.
    """

    name = "rtps"
    needs_turns = True

    def __init__(self, announces_nodes: bool = True) -> None:
        super().__init__()
        self._announces_nodes = announces_nodes
        self._environment = dict(os.environ)
        discovery_range(self._environment)  # a wrong value is reported at once
        self._domains: dict[int, RtpsDomain] = {}
        self._stays_local: dict[int, bool] = {}
        self._graphs: list[RtpsGraph] = []
        self.unsent: set[RtpsDomain] = set()
        self._ready: dict[RtpsReader, None] = {}
        self._is_receiving = False
        self._poller = poller.create()
        self._wakeup = WakeupFd()
        # What receives, in the order in which it is called.
        self._receivers: list[Callable[[], None]] = [self._wakeup.clear]
        self._poller.watch(self._wakeup.fileno(), self._receivers[0])
        self._closed = False

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> RtpsNode:
        """Create a node.

        Raises:
            MiddlewareError: The domain cannot be joined, or not on loopback alone.
        """
        joined = self._join(domain, localhost_only)
        assert joined.info is not None, "of a middleware that announces no nodes"
        entry = NodeEntry(joined.info.nodes, joined.info.changed, namespace, name)
        return RtpsNode(joined, entry)

    def create_service_node(self, domain: int, entry: NodeEntry, localhost_only: bool) -> RtpsNode:
        """Create what holds the service endpoints of a node that another participant announces.

        Args:
            domain: The domain.
            entry: The node; the endpoints are listed there. It is closed with the result.
            localhost_only: As in :meth:`create_node`.

        Raises:
            MiddlewareError: As in :meth:`create_node`.
        """
        return RtpsNode(self._join(domain, localhost_only), entry)

    def _join(self, domain: int, localhost_only: bool) -> RtpsDomain:
        check_domain(domain)
        if localhost_only:
            if domain not in self._stays_local:  # peers are looked up: not for each node again
                self._stays_local[domain] = network.stays_local(self._environment, domain)
            check_loopback(
                domain, self._stays_local[domain],
                ", and without other peers and interfaces in ROS_STATIC_PEERS and CYCLONEDDS_URI",
            )  # fmt: skip
        return self._domain(domain)

    def _domain(self, number: int) -> RtpsDomain:
        domain = self._domains.get(number)
        if domain is None:
            check_number_joined(number, self._domains)
            domain = RtpsDomain(self, number, self._environment, self._announces_nodes)
            self._domains[number] = domain
            for fileno in domain.filenos():
                receive = functools.partial(domain.receive, fileno)
                self._receivers.append(receive)
                self._poller.watch(fileno, receive)
        return domain

    def graph(self, domain: int, on_change: Callable[[], None], paced: bool = True) -> RtpsGraph:
        """Watch the graph of a domain until the result is closed."""
        check_domain(domain)
        graph = RtpsGraph(self._domain(domain), on_change, self._graphs.remove, paced)
        self._graphs.append(graph)
        return graph

    def ready(self, reader: RtpsReader) -> None:
        """Have a reader's ``on_ready`` called by the next dispatch."""
        # Otherwise dispatch_local follows.
        if not self._ready and not self._is_receiving and not self.batching:
            self._wakeup.set()
        self._ready[reader] = None

    def fileno(self) -> int:
        """Return the descriptor that is readable when :meth:`dispatch` has work."""
        return self._poller.fileno()

    def dispatch(self) -> None:
        """Receive, and call ``on_ready`` of each reader that received something."""
        if self._closed:
            return
        self._is_receiving = True  # dispatch_local follows: nothing needs to be woken
        try:
            ready = self._poller.poll(0)
            if len(ready) > 1:
                # What announces a writer comes before its first sample.
                ready.sort(key=self._receivers.index)
            for receive in ready:
                receive()
        except BaseException:
            self._wakeup.set()  # for what was received before
            raise
        finally:
            self._is_receiving = False
        self.dispatch_local()

    def dispatch_local(self) -> None:
        """Call ``on_ready`` of each reader that has a sample."""
        if not self._ready:
            return
        for reader in list(self._ready):
            if reader not in self._ready:
                continue  # closed meanwhile
            del self._ready[reader]
            try:
                if reader.is_open:
                    reader.on_ready()
            except BaseException:
                self._wakeup.set()  # for the others
                raise
        if self._ready:
            self._wakeup.set()  # they asked for another turn

    def flush(self) -> None:
        """Send what is held back."""
        unsent = self.unsent
        while unsent:
            unsent.pop().flush()

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` has work (``time.monotonic``), or None."""
        deadline = None
        for domain in self._domains.values():  # in each turn: without a generator
            at = domain.next_deadline()
            if at is not None and (deadline is None or at < deadline):
                deadline = at
        for graph in self._graphs:
            at = graph.paced.due
            if at is not None and (deadline is None or at < deadline):
                deadline = at
        return deadline

    def tick(self) -> None:
        """Do what is due by time: announcements, heartbeats, acknowledgements, the graph."""
        for domain in self._domains.values():
            domain.tick()
        now = time.monotonic()
        for graph in list(self._graphs):
            if graph.paced.due is not None and graph.paced.due <= now:
                graph.paced.tick(now)

    def close(self) -> None:
        """Leave all domains; idempotent."""
        if self._closed:
            return
        self._closed = True
        for domain in self._domains.values():
            domain.close()
        self._ready.clear()
        self._poller.close()
        self._wakeup.close()
