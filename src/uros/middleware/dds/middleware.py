"""The contract of :mod:`uros.middleware.base` on Cyclone DDS."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from ..base import Middleware, MiddlewareError, check_domain
from ..discovery_info.gid_size import configured_gid_size
from ..domains import check_loopback, check_number_joined
from ..environment import discovery_range
from ..wakeup_fd import WakeupFd
from . import config, cyclone
from .context import DdsContext
from .discovery import GraphDiscovery
from .domain import DdsDomain
from .node import DdsNode


class DdsMiddleware(Middleware):
    """Cyclone DDS, configured by this process's environment.

    A domain is opened by its first node, and closed with the middleware.

    Attributes:
        context: What its parts share.

    Raises:
        MiddlewareError: ROS_AUTOMATIC_DISCOVERY_RANGE has a value that does not exist.
    """

    name = "dds"
    needs_turns = True

    def __init__(self) -> None:
        super().__init__()
        self._environment = dict(os.environ)
        discovery_range(self._environment)  # a wrong value is reported at once
        self.context = DdsContext(self)
        self._domains: dict[int, DdsDomain] = {}
        self._closed = False

    @property
    def wakeup(self) -> WakeupFd:
        """The descriptor of :meth:`fileno`; others in this process may set it."""
        return self.context.dispatcher.wakeup

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> DdsNode:
        """Create a node.

        Raises:
            MiddlewareError: The domain cannot be joined, or not on loopback alone.
        """
        check_domain(domain)
        if localhost_only:
            check_loopback(
                domain, config.stays_on_loopback(self._environment),
                ", and without other interfaces in CYCLONEDDS_URI",
            )  # fmt: skip
        return DdsNode(self.context, self._domain(domain), namespace, name)

    def _domain(self, number: int) -> DdsDomain:
        domain = self._domains.get(number)
        if domain is None:
            check_number_joined(number, self._domains)
            try:
                cyclone.open_domain(number, config.config_xml(self._environment, os.getpid()))
            except MiddlewareError as error:
                if self._environment.get("CYCLONEDDS_URI"):
                    raise MiddlewareError(f"{error}; is CYCLONEDDS_URI right?") from error
                raise
            gid_size = configured_gid_size(self._environment)
            domain = self._domains[number] = DdsDomain(self.context, number, gid_size)
        return domain

    def graph(
        self, domain: int, on_change: Callable[[], None], paced: bool = True
    ) -> GraphDiscovery:
        """Watch the graph of a domain until the result is closed."""
        check_domain(domain)
        return self._domain(domain).graph(on_change, paced)

    def fileno(self) -> int:
        """Return the descriptor that is readable when :meth:`dispatch` has work."""
        return self.wakeup.fileno()

    def dispatch(self) -> None:
        """Call ``on_ready`` of each reader that received something."""
        self.context.dispatcher.dispatch()

    def dispatch_local(self) -> None:
        """Call ``on_ready`` of each reader that this process has written to."""
        dispatcher = self.context.dispatcher
        if dispatcher.noted:
            dispatcher.dispatch_local()

    def flush(self) -> None:
        """Send the samples that writers hold back."""
        unsent = self.context.unsent
        while unsent:
            cyclone.flush(unsent.pop())

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` has work (``time.monotonic``), or None."""
        return self.context.schedule.next_deadline()

    def tick(self) -> None:
        """Do what is due by time: discovery info, the graph's changes, probe readers."""
        self.context.schedule.tick(time.monotonic())

    def close(self) -> None:
        """Leave all domains; idempotent."""
        if self._closed:
            return
        self._closed = True
        self.context.dispatcher.stop()
        for number, domain in self._domains.items():
            domain.close()
            cyclone.close_domain(number)
        self.context.dispatcher.close()
