"""The contract between the agent (or a host program) and a middleware.

Samples are CDR with their 4-byte encapsulation header (RTPS 10.5) and types are
only names, so nothing here needs to know what a message looks like.

Everything is called from one thread, which runs the *data plane*: the agent's main
thread with its selector, or that of a host program. The middleware wakes it
through :meth:`Middleware.fileno`; :meth:`Middleware.dispatch` then calls the
``on_ready`` of each reader that has something to :meth:`Reader.take`. ``on_ready``
means "something has arrived since you last took"; samples that were left in the reader
do not cause another call.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

from ..qos import QoSProfile
from .graph import LiveSource

Bytes = bytes | bytearray | memoryview
OnReady = Callable[[], None]
# (topic, its type here, its type elsewhere): endpoints of the two types do not match.
OnTypeConflict = Callable[[str, str, str], None]
# One line for the user: what does not work as expected, and the remedy.
OnNotice = Callable[[str], None]


# The most notices that are given and remembered, because a client may create one service after the
# other, each with a notice.
_MAX_NOTICES: Final = 1000


class MiddlewareError(RuntimeError):
    """The middleware refuses, or cannot do, what was asked; the text says why."""


MAX_DOMAIN = 232  # the last one with valid RTPS port numbers
# The most samples that a transient-local KEEP_ALL writer has for late readers, as with Fast DDS.
MAX_PAST = 5000


def check_domain(domain: int) -> None:
    """Check that RTPS has ports for a domain.

    Raises:
        MiddlewareError: It has none.
    """
    if not 0 <= domain <= MAX_DOMAIN:
        raise MiddlewareError(f"domain {domain} is not within 0 to {MAX_DOMAIN}")


class Writer(ABC):
    """Publishes samples on one topic."""

    __slots__ = ()

    @abstractmethod
    def write(self, cdr: Bytes) -> bool:
        """Write one sample, with its encapsulation header.

        Returns:
            False if there is no room now: nothing was sent, try again.

        Raises:
            MiddlewareError: The sample can never be written.
        """

    def matched(self) -> int:
        """Return how many readers match it, those of this process included; 0 if unknown."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Leave the topic; idempotent."""


class Reader(ABC):
    """Receives samples of one topic.

    Attributes:
        counts_replaced: Whether :meth:`lost` counts samples that newer ones replaced.
    """

    __slots__ = ()
    counts_replaced = True

    @abstractmethod
    def take(self, limit: int) -> list[bytes]:
        """Take at most ``limit`` samples out of the reader, oldest first.

        Fewer mean that no more wait.
        """

    def take_stamped(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take samples as :meth:`take` does: (sample, source time in Unix ns, GUID of the writer).

        The time is 0 and the GUID empty where they are unknown.
        """
        return [(sample, 0, b"") for sample in self.take(limit)]

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of the samples that have arrived since the last call and wait here.

        Each sample is reported once, and at most ``limit`` of them. As after :meth:`take`, the next
        sample causes a call of ``on_ready``. An endpoint that does not know returns nothing.
        """
        return []

    def lost(self) -> int:
        """Return how many samples for it were lost until now, as far as the middleware knows.

        Those are samples that the network lost, that their writer no longer had, or, with
        :attr:`counts_replaced`, that newer ones replaced here before they were taken.
        """
        return 0

    @abstractmethod
    def close(self) -> None:
        """Leave the topic; idempotent."""


class Requester(ABC):
    """Sends requests of one service and receives the replies to them.

    ``on_ready`` is also called when :meth:`refusal` may have changed.
    """

    __slots__ = ()

    def refusal(self) -> str:
        """Return why no request is sent and no pending one will be answered; empty if none.

        The reason is a server that would read the arguments wrongly.
        """
        return ""

    def servers(self) -> int | None:
        """Return how many servers match both endpoints; None if this middleware does not know."""
        return None

    def again(self) -> None:  # noqa: B027  some middlewares call on_ready anyway
        """Have ``on_ready`` called again after those of others, because samples are left."""

    @abstractmethod
    def request(self, cdr: Bytes) -> int | None:
        """Send a request.

        Returns:
            The sequence number of its reply; None if there is no room now.

        Raises:
            MiddlewareError: There is a :meth:`refusal`.
        """

    @abstractmethod
    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Take at most ``limit`` replies to own requests: (sequence number, sample).

        Replies to others are dropped. Fewer than ``limit`` mean that no more wait, or so many to
        others that ``on_ready`` is called again for the rest.
        """

    def arrived(self, limit: int) -> list[int]:
        """Return sizes as :meth:`Reader.arrived` does."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Leave the service; idempotent."""


class Replier(ABC):
    """Receives requests of one service and sends the replies."""

    __slots__ = ()

    @abstractmethod
    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take at most ``limit`` requests: (16-byte GUID of the client, sequence number, sample).

        Fewer mean that no more wait, or that ``on_ready`` is called again for the rest.
        """

    @abstractmethod
    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        """Reply to the request with that GUID and sequence number; False: no room now."""

    def arrived(self, limit: int) -> list[int]:
        """Return sizes as :meth:`Reader.arrived` does."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Leave the service; idempotent."""


class Node(ABC):
    """A node of the ROS graph, with its endpoints."""

    @abstractmethod
    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Writer:
        """Create the writer of a publisher.

        Args:
            topic: The DDS name, ``rt/chatter``.
            type_name: The DDS name, ``std_msgs::msg::dds_::String_``.
            qos: The profile.

        Raises:
            MiddlewareError: It cannot be created.
        """

    @abstractmethod
    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Reader:
        """Create the reader of a subscription; see :meth:`create_writer`.

        ``on_ready`` is called from :meth:`Middleware.dispatch`.
        """

    @abstractmethod
    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        """Create a service client; see :meth:`create_reader`."""

    @abstractmethod
    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        """Create the server of a service; see :meth:`create_reader`."""

    @abstractmethod
    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""


class Service:
    """The two topics of a service and their types, by DDS names."""

    __slots__ = ("reply_topic", "reply_type", "request_topic", "request_type")

    def __init__(
        self, request_topic: str, request_type: str, reply_topic: str, reply_type: str
    ) -> None:
        self.request_topic = request_topic
        self.request_type = request_type
        self.reply_topic = reply_topic
        self.reply_type = reply_type


class Middleware(ABC):
    """A network to join.

    Attributes:
        name: What ``open_middleware`` calls it.
        any_name: Whether any text may name a topic or a node, as no ROS node sees them.
        needs_turns: Whether nodes are discovered only while :meth:`dispatch` and :meth:`tick` are
            called several times a second.
        on_type_conflict: Called when a topic has another type elsewhere. Set before the first node.
        on_notice: Called with each notice for the user, once. Set before the first node.
        batching: Whether the caller calls :meth:`flush` and :meth:`dispatch_local` after each
            burst, so that samples may be held back until then. Set before the first node.
        engines: The middlewares that it combines, or itself alone; the list may grow. The agent
            calls :meth:`flush`, :meth:`dispatch_local` and :meth:`next_deadline` of each.
    """

    name = ""
    any_name = False
    needs_turns = False
    on_type_conflict: OnTypeConflict | None = None
    on_notice: OnNotice | None = None
    batching = False

    def __init__(self) -> None:
        self._noticed: set[str] = set()
        self.engines: list[Middleware] = [self]

    def notice(self, text: str) -> None:
        """Pass a notice to :attr:`on_notice`, once for each text."""
        if self.on_notice is not None and text not in self._noticed:
            if len(self._noticed) < _MAX_NOTICES:
                self._noticed.add(text)
                self.on_notice(text)

    @abstractmethod
    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> Node:
        """Enter the graph of ``domain`` (0–232) as the node ``namespace/name``.

        Raises:
            MiddlewareError: The domain cannot be joined, or not on loopback alone.
        """

    @abstractmethod
    def fileno(self) -> int:
        """Return a descriptor that is readable when :meth:`dispatch` has work."""

    @abstractmethod
    def dispatch(self) -> None:
        """Call ``on_ready`` of every reader that received something."""

    def flush(self) -> None:  # noqa: B027  most hold nothing back
        """Send what :attr:`batching` has held back. The data plane calls it after each burst."""

    def dispatch_local(self) -> None:  # noqa: B027  optional
        """Do the same for what this process itself wrote, sooner than by :meth:`fileno`.

        The data plane calls it after each burst of writes.
        """

    def graph(
        self, domain: int, on_change: Callable[[], None], paced: bool = True
    ) -> LiveSource | None:
        """Watch the graph of a domain until the result is closed.

        Args:
            domain: The domain.
            on_change: Called after changes, from :meth:`tick`, :meth:`dispatch` and, without
                pauses, also from what changes the graph.
            paced: Whether there are pauses between the calls, which leave room for other traffic.

        Returns:
            None if this middleware does not know the graph.
        """
        return None

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` is to be called (``time.monotonic``), or None."""
        return None

    def tick(self) -> None:  # noqa: B027  most have nothing to do
        """Do what is due by time, such as announcing the graph."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network; idempotent."""
