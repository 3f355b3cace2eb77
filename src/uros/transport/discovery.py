"""Transport of a board that finds its agent by discovery: multicast, or a list of addresses.

    from uros.transport.discovery import DiscoveringTransport

    node = Node("node", DiscoveringTransport(), key=0x1001)

The agent must have been started with ``--discovery``. Answers are not authenticated, as with
micro-ROS: in a shared network give the address of the agent instead, or use TLS. Runs on
MicroPython ports that have a network; a board need not join a multicast group to ask it.
"""

import errno
import select
import socket

from ..ticks import ticks_add, ticks_diff, ticks_ms
from ..wire import ids
from ..wire.cdr import Reader
from ..wire.errors import DecodeError
from ..wire.header import pull_header, pull_subheader
from ..wire.session import pull_info
from .udp import UdpTransport

try:
    from typing import Any, Callable, Final, Sequence

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

# Where agents listen for GET_INFO, eProsima's included.
AGENTS: Final = (("239.255.0.2", 7400),)
# GET_INFO outside of any session, request 9, about the agent: its configuration and activity.
QUESTION: Final = b"\x80\0\0\0\2\1\x08\0\0\x09\xff\xfd\3\0\0\0"
_REQUEST: Final = 9
# Period of GET_INFO: requests and answers can be lost.
_AGAIN_MS: Final = 250
# Longest answer in bytes: 64 locators, more than any agent sends.
_LARGEST: Final = 600
# Most datagrams read in one call: other datagrams are ignored, but a flood must not block.
_BURST: Final = 16
_LOOPBACK: Final = "0:0:0:0:0:0:0:1"
_REMEDY: Final = "start one with --discovery in this network, and look at firewalls"
_SILENT: Final = "look at firewalls, and whether it speaks UDP there or TCP"


def discover_agent(
    timeout_ms: int = 1000,
    addresses: "Sequence[tuple[str, int]]" = AGENTS,
    interface: str = "",
) -> "tuple[str, int] | None":
    """Wait for the first agent that answers.

    Args:
        timeout_ms: Longest wait.
        addresses: Multicast groups, and addresses or names of hosts (IPv4), asked four times a
            second.
        interface: The board's own address in the network to ask, if it has several.

    Returns:
        ``(host, port)`` of the agent, or None.

    Raises:
        OSError: No request can be sent: the network is down.
    """
    end = ticks_add(ticks_ms(), timeout_ms)
    search = _Search(addresses, interface)
    try:
        while True:
            search.ask()
            left = ticks_diff(end, ticks_ms())
            again = ticks_add(ticks_ms(), min(left, _AGAIN_MS))
            while True:
                left = ticks_diff(again, ticks_ms())
                agents = search.take(max(0, left))
                if agents:
                    return agents[0]
                if left <= 0:
                    break
            if ticks_diff(end, ticks_ms()) <= 0:
                return None
    finally:
        search.close()


class DiscoveringTransport:
    """Transport to the first agent that answers; when that agent is lost, it searches again.

    ``agent`` is the ``(host, port)`` in use, None while there is none. Nothing blocks except for
    the look-up of names.

    Args:
        addresses: See :func:`discover_agent`.
        interface: See :func:`discover_agent`.
        mtu: The largest message in bytes.
        patience_ms: Time without an answer after which a locator is given up; the next of the
            agent's locators is then tried.
        make: ``make(host, port, mtu)`` creates the transport to the agent: an INFO does not say
            whether its locators are UDP or TCP.
    """

    def __init__(
        self,
        addresses: "Sequence[tuple[str, int]]" = AGENTS,
        interface: str = "",
        mtu: int = 512,
        patience_ms: int = 3000,
        make: "Callable[[str, int, int], Any]" = UdpTransport,
    ) -> None:
        self.mtu = mtu
        self.agent: "Any" = None
        self._addresses = addresses
        self._interface = interface
        self._patience_ms = patience_ms
        self._make = make
        self._turn = 0  # which of an agent's locators to try next
        self._search: "Any" = None
        self._line: "Any" = None  # the transport to the agent, once there is one
        self._last_message = b""  # the last message sent before there was an agent
        self._again = 0  # when GET_INFO is due
        self._until: "int | None" = None  # when the search or the locator is given up

    def open(self) -> None:
        """Begin to search.

        Raises:
            OSError: No request can be sent: the network is down.
        """
        self.close()
        self._search = _Search(self._addresses, self._interface)
        try:
            self._ask()
        except OSError:
            self.close()
            raise
        self._until = ticks_add(ticks_ms(), self._patience_ms)

    def _ask(self) -> None:
        self._again = ticks_add(ticks_ms(), _AGAIN_MS)
        self._search.ask()

    def close(self) -> None:
        """Close the transport; idempotent."""
        search, line = self._search, self._line
        self._search = self._line = self.agent = None
        self._last_message = b""
        if search is not None:
            search.close()
        if line is not None:
            line.close()

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`; without ``size`` the whole message is sent.

        While there is no agent, the last message is kept for it, and GET_INFO is repeated.
        """
        if self._line is not None:
            self._line.send(message, size)
            return
        self._last_message = bytes(message if size < 0 else memoryview(message)[:size])
        if ticks_diff(self._again, ticks_ms()) <= 0:
            self._ask()

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`."""
        end = ticks_add(ticks_ms(), timeout_ms)
        if self._line is None:
            agents = self._search.take(timeout_ms)
            if not agents:
                if self._late():
                    where = ", ".join(["%s port %d" % address for address in self._addresses])
                    raise OSError(errno.ETIMEDOUT, "no agent answers at %s: %s" % (where, _REMEDY))
                return None
            self._link(agents)
        message: "bytes | None" = self._line.receive(max(0, ticks_diff(end, ticks_ms())))
        if message is None:
            if self._late():
                trouble = "an agent says that it is at %s port %d, and is silent there: %s"
                raise OSError(errno.ETIMEDOUT, trouble % (self.agent + (_SILENT,)))
        elif self._until is not None:
            self._until = None  # from now on the node detects the loss of the agent
            self._turn -= 1
        return message

    def _link(self, agents: "list[tuple[str, int]]") -> None:
        agent = agents[self._turn % len(agents)]
        self._turn += 1  # the next locator, unless this one answers
        self._search.close()
        line = self._make(agent[0], agent[1], self.mtu)
        line.open()
        self._line = line
        self.agent = agent
        self._until = ticks_add(ticks_ms(), self._patience_ms)
        if self._last_message:
            line.send(self._last_message, len(self._last_message))
            self._last_message = b""

    def _late(self) -> bool:
        return self._until is not None and ticks_diff(self._until, ticks_ms()) <= 0


class _Search:
    """Socket that sends GET_INFO and receives the answers."""

    def __init__(self, addresses: "Sequence[tuple[str, int]]", interface: str) -> None:
        self._addresses = addresses
        self._socket: "Any" = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if interface:
                # This also selects the interface for multicast, for which ports have no option.
                self._socket.bind(_address(interface, 0))
            self._socket.setblocking(False)
            self._poll = select.poll()
            self._poll.register(self._socket, select.POLLIN)
        except OSError:
            self._socket.close()
            raise

    def close(self) -> None:
        self._socket.close()

    def ask(self) -> None:
        """Send GET_INFO to all addresses.

        Raises:
            OSError: None of the requests could be sent.
        """
        trouble = OSError(errno.EINVAL, "there is no address to ask for an agent: give one")
        sent = False
        for host, port in self._addresses:
            try:
                self._socket.sendto(QUESTION, _address(host, port))
                sent = True
            except OSError as error:
                trouble = error
        if not sent:
            raise trouble

    def take(self, timeout_ms: int) -> "list[tuple[str, int]]":
        """Return the locators of the next agent that answers, the best first; empty if none."""
        end = ticks_add(ticks_ms(), timeout_ms)
        for _ in range(_BURST):
            if not self._poll.poll(max(0, ticks_diff(end, ticks_ms()))):
                break
            try:
                answer, source = self._socket.recvfrom(_LARGEST)
                # Some MicroPython ports give the address as bytes.
                host = source[0] if isinstance(source, tuple) else ""
                agents = agents_of(answer, host)
            except (OSError, DecodeError):  # no agent at the address; not an answer
                continue
            if agents:
                return agents
        return []


def _address(host: str, port: int) -> "Any":
    """Return the IPv4 address for a socket: agents listen for GET_INFO on IPv4 only."""
    for info in socket.getaddrinfo(host, port, 0, socket.SOCK_DGRAM):
        if info[0] == socket.AF_INET:
            return info[-1]
    raise OSError(errno.EINVAL, "%s has no address of IPv4" % host)


def agents_of(answer: "Buffer", source: str = "") -> "list[tuple[str, int]]":
    """Return ``(host, port)`` of each locator in an agent's answer, the best first.

    eProsima's agent sends all addresses of its machine. The address that the answer came from is
    first and replaces "all addresses"; then follow other IPv4 addresses, IPv6, and loopback, unless
    the answer came by loopback.

    Args:
        answer: The datagram.
        source: The address it came from.

    Raises:
        DecodeError: The datagram is no answer to QUESTION.
    """
    size = len(answer)
    at = pull_header(answer, size)[4]
    kind, flags, start, stop = pull_subheader(answer, at, size)
    if kind != ids.INFO:
        raise DecodeError("submessage %d is no answer" % kind)
    r = Reader(answer, start, stop, bool(flags & ids.FLAG_LITTLE_ENDIAN))
    request, subject, status, _, locators = pull_info(r)
    if request != _REQUEST or subject != ids.OBJECT_AGENT or status > ids.STATUS_OK_MATCHED:
        raise DecodeError("an answer to something else")
    ranked: "list[tuple[int, int, str, int]]" = []
    for octets, port in locators:
        host = source if octets == bytes(len(octets)) else _text(octets)
        if not host or not 0 < port < 0x10000:
            continue
        rank = 2 if ":" in host else 1
        if host == source:
            rank = 0
        elif host.startswith("127.") or host == _LOOPBACK:
            rank = 1 if source.startswith("127.") else 3
        # The position keeps the order: MicroPython's sort is not stable.
        ranked.append((rank, len(ranked), host, port))
    ranked.sort()
    agents: "list[tuple[str, int]]" = []
    for _, _, host, port in ranked:
        if (host, port) not in agents:
            agents.append((host, port))
    return agents


def _text(octets: bytes) -> str:
    """Return an address as text; empty for a multicast or link-local one, which is not used."""
    if len(octets) == 4:
        return "" if octets[0] >= 224 else "%d.%d.%d.%d" % tuple(octets)
    if octets[0] == 0xFF or (octets[0] == 0xFE and octets[1] & 0xC0 == 0x80):
        return ""
    return ":".join(["%x" % (octets[i] << 8 | octets[i + 1]) for i in range(0, 16, 2)])
