"""The contract between the agent (or a host program) and a middleware.

Samples are CDR with their 4-byte encapsulation header (RTPS 10.5), types are
only names: nothing here needs to know what a message looks like.

Everything is called from one thread, the data plane's. The middleware wakes it
through :meth:`Middleware.fileno`; :meth:`Middleware.dispatch` then calls the
``on_ready`` of each reader that has something to :meth:`Reader.take`. ``on_ready``
says "since you last took"; what was left in the reader is not announced again.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable

from ..qos import QoSProfile
from .graph import LiveSource

Bytes = bytes | bytearray | memoryview
OnReady = Callable[[], None]
# (topic, its type here, its type elsewhere): their samples do not reach each other.
OnTypeConflict = Callable[[str, str, str], None]
# One line for the user: what does not work as it might, and the remedy.
OnNotice = Callable[[str], None]


class MiddlewareError(RuntimeError):
    """The middleware refuses, or cannot do, what was asked; the text says why."""


MAX_DOMAIN = 232  # RTPS port numbers end there
# What a transient-local writer that keeps all has for readers that come late, as with Fast DDS.
MAX_PAST = 5000


def check_domain(domain: int) -> None:
    """Raises MiddlewareError for a domain that RTPS has no ports for."""
    if not 0 <= domain <= MAX_DOMAIN:
        raise MiddlewareError(f"domain {domain} is not within 0 to {MAX_DOMAIN}")


def environment_domain() -> int:
    """The domain that ROS_DOMAIN_ID names, or 0. Raises MiddlewareError for what is no domain."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if text and not (text.isdecimal() and int(text) <= MAX_DOMAIN):
        raise MiddlewareError(f"ROS_DOMAIN_ID: {text!r} is no domain; give 0 to {MAX_DOMAIN}")
    return int(text or 0)



class Writer(ABC):
    """Publishes samples on one topic."""

    __slots__ = ()

    @abstractmethod
    def write(self, cdr: Bytes) -> bool:
        """Hand over one sample. False: no room now, try again; nothing was sent."""

    def matched(self) -> int:
        """How many readers it has, as far as that is known, those of this process included."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Leave the topic. Twice is once."""


class Reader(ABC):
    """Receives samples of one topic."""

    __slots__ = ()

    @abstractmethod
    def take(self, limit: int) -> list[bytes]:
        """At most ``limit`` samples, oldest first; they are gone from here then."""

    def arrived(self, limit: int) -> list[int]:
        """The octets of samples that have come and wait here, at most ``limit`` of them, each told
        once; what comes next is announced as after :meth:`take`. An end that cannot tell says
        nothing.
        """
        return []

    @abstractmethod
    def close(self) -> None:
        """Leave the topic. Twice is once."""


class Requester(ABC):
    """Sends requests of one service and receives the replies to them.

    ``on_ready`` comes as well when :meth:`refusal` may have become another.
    """

    __slots__ = ()

    def refusal(self) -> str:
        """Why no call is made, and none that waits will be answered: a server is there that would
        read its arguments wrongly. Empty where calls can be made.
        """
        return ""

    def again(self) -> None:  # noqa: B027  where what is left is announced anyway
        """Have ``on_ready`` called again, after others: not all was taken."""

    @abstractmethod
    def request(self, cdr: Bytes) -> int | None:
        """Send; the sequence number its reply will bear. None: no room now.

        Raises MiddlewareError where there is a :meth:`refusal`.
        """

    @abstractmethod
    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """At most ``limit`` replies to own requests: (sequence number, sample).

        Others' replies are passed over. None: there are none, or so many of others that
        ``on_ready`` comes again for the rest.
        """

    def arrived(self, limit: int) -> list[int]:
        """See :meth:`Reader.arrived`."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Leave the service. Twice is once."""


class Replier(ABC):
    """Receives requests of one service and sends the replies."""

    __slots__ = ()

    @abstractmethod
    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """At most ``limit`` requests: (16-byte GUID of the asker, number, sample).

        None: there are none, or ``on_ready`` comes again for the rest.
        """

    @abstractmethod
    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        """Answer the request of that identity. False: no room now."""

    def arrived(self, limit: int) -> list[int]:
        """See :meth:`Reader.arrived`."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Leave the service. Twice is once."""


class Node(ABC):
    """A node of the ROS graph, in which endpoints stand."""

    @abstractmethod
    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Writer:
        """Join ``topic`` (DDS name, ``rt/chatter``) as a publisher of
        ``type_name`` (DDS name, ``std_msgs::msg::dds_::String_``).

        Raises MiddlewareError, here and below, where it cannot be done.
        """

    @abstractmethod
    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Reader:
        """Join ``topic`` as a subscriber."""

    @abstractmethod
    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        """Join a service as a client."""

    @abstractmethod
    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        """Join a service as its server."""

    @abstractmethod
    def close(self) -> None:
        """Leave the graph, and with it all endpoints. Twice is once."""


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
    """One network to join."""

    name = ""
    # Whether any text may name a topic or a node, as nobody of ROS sees it.
    any_name = False
    on_type_conflict: OnTypeConflict | None = None
    on_notice: OnNotice | None = None
    # Set before the first node: what is written may then stay here until :meth:`flush`.
    batching = False

    @abstractmethod
    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> Node:
        """Enter the graph of ``domain`` (0–232) as the node ``namespace/name``."""

    @abstractmethod
    def fileno(self) -> int:
        """A descriptor that is readable when :meth:`dispatch` has work."""

    @abstractmethod
    def dispatch(self) -> None:
        """Call ``on_ready`` of every reader that received something."""

    def flush(self) -> None:  # noqa: B027  most keep nothing back
        """Send what :attr:`batching` has kept back. The data plane calls it after each burst."""

    def dispatch_local(self) -> None:  # noqa: B027  a short cut that most do not have
        """The same for what this process itself wrote, sooner than by :meth:`fileno`.

        The data plane calls it after each burst of writes.
        """

    def graph(self, domain: int, on_change: Callable[[], None]) -> LiveSource | None:
        """Watch who is in a domain, until the result is closed; None where that is not known.

        ``on_change`` is called from :meth:`tick` or :meth:`dispatch` after news, with a pause
        between that leaves room for other traffic.
        """
        return None

    def next_deadline(self) -> float | None:
        """When :meth:`tick` wants to be called (``time.monotonic``), or None."""
        return None

    def tick(self) -> None:  # noqa: B027  most have nothing to do
        """Do what is due by time, such as announcing the graph."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network. Twice is once."""
