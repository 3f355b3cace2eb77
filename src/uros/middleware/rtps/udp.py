"""The UDP sockets of one domain, on the interfaces that there are at each time.

Two ports receive discovery and samples by unicast: the well-known ones of the lowest free
participant index (RTPS 9.6.2.3), so that peers which know only the address find it. Where multicast
is allowed, a further socket for each version of IP receives the announcements of all participants.
"""

from __future__ import annotations

import errno
import socket
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final

from ... import addresses
from ...addresses import Interface
from ...poller import has_input
from ..base import MiddlewareError
from . import locators, network
from .ip_sockets import IpSockets
from .locators import UDPV4, UDPV6, Locator
from .network import NetworkSettings

# The last index whose ports are those of its own domain (RTPS 9.6.2.3).
MAX_INDEX: Final = 119
# Ports that the system gives for IPv4 and that may be taken on IPv6.
_MAX_TRIES: Final = 16
# Seconds between looks at the interfaces. A cable or a Wi-Fi that comes back is used after so long,
# where the system does not tell of it at once.
SCAN_PERIOD: Final = 3.0
# A link that comes and goes all the time: seconds between looks at least.
_SCAN_PAUSE: Final = 0.1
_LARGEST: Final = 65536
# Attack: a flood of datagrams. A socket is drained up to so many, then others have their turn.
MAX_BURST: Final = 64
# Errors of sending that say that an address is not reached from here.
_UNREACHABLE: Final = frozenset(
    (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENODEV, errno.ENXIO, errno.EADDRNOTAVAIL,
     errno.ENETDOWN)
)  # fmt: skip


class DomainSockets:
    """The sockets of a domain.

    Attributes:
        unicast: Where peers reach us for discovery.
        data: Where they reach us with samples.
        multicast: Where all participants of the domain receive announcements; empty without.
        peers: Further places to announce to.
        send_errors: Datagrams that the system did not take, by ``errno``.
        unreachable: Addresses that no interface has reached; the caller clears it.
        scan_at: When :meth:`scan` is due (``time.monotonic``); None: never.
        notices: What the user should know.

    Args:
        domain: The domain.
        settings: What it uses of the network.
        now: The time (``time.monotonic``).
        list_interfaces: Returns the interfaces that are up.
        change_socket: Returns a socket that receives something when they have changed, or None.

    Raises:
        MiddlewareError: No index is free, the configured one is too high, or the ports cannot be
            opened.
    """

    def __init__(
        self,
        domain: int,
        settings: NetworkSettings,
        now: float,
        list_interfaces: Callable[[], list[Interface]] = addresses.interfaces,
        change_socket: Callable[[], socket.socket | None] = addresses.change_socket,
    ) -> None:
        self.unicast: list[Locator] = []
        self.data: list[Locator] = []
        self.multicast: list[Locator] = []
        self.peers = list(settings.peers)
        self.send_errors: Counter[int] = Counter()
        self.unreachable: set[str] = set()
        self.scan_at: float | None = None
        self._scanned_at = now
        self.notices = list(settings.notices)
        self._settings = settings
        self._list_interfaces = list_interfaces
        self._interfaces: list[Interface] = []
        self._sockets: dict[int, IpSockets] = {}
        self._receiving: dict[int, tuple[int, socket.socket]] = {}  # by descriptor
        self._for_samples: set[int] = set()  # descriptors
        self._changes: socket.socket | None = None
        self._buffer = bytearray(_LARGEST)
        self._view = memoryview(self._buffer)
        if settings.is_off:
            return
        self._open(domain)
        try:
            if settings.multicast:
                for each in self._sockets.values():
                    each.open_multicast(locators.multicast_port(domain))
        except MiddlewareError:
            self.close()
            raise
        for kind, each in self._sockets.items():
            self._receiving.update((sock.fileno(), (kind, sock)) for sock in each.sockets)
            self._for_samples.add(each.sockets[-1].fileno())
        if not settings.stays_local:
            self._changes = change_socket()
        self.scan(now)
        self._check_choices()

    # --- opening -------------------------------------------------------------------------------

    def _open(self, domain: int) -> None:
        """Open the sockets on the port of the participant index."""
        wanted = self._settings.index
        if wanted == -1:
            self._open_anywhere(domain)
            return
        indices = [
            index
            for index in range(MAX_INDEX + 1)
            if locators.metatraffic_port(domain, index) <= locators.MAX_PORT
        ]
        if wanted is not None and wanted not in indices:
            raise MiddlewareError(
                f"CYCLONEDDS_URI: ParticipantIndex {wanted} has no port of its own in domain"
                f" {domain}: write one of 0 to {indices[-1]}, or auto"
            )
        for index in (*(() if wanted is None else (wanted,)), *indices):
            if self._open_at(domain, locators.metatraffic_port(domain, index)):
                self._check_index(domain, index)
                return
        raise MiddlewareError(
            f"domain {domain} has no free participant index on this machine: use another domain"
        )

    def _open_anywhere(self, domain: int) -> None:
        """Open the sockets on a port that is free on all versions of IP."""
        for _ in range(_MAX_TRIES):
            if self._open_at(domain, 0):
                return
        raise MiddlewareError(
            f"domain {domain}: this machine has no port that is free on IPv4 and IPv6: end programs"
            " that use UDP, or take ParticipantIndex none out of CYCLONEDDS_URI"
        )

    def _check_index(self, domain: int, index: int) -> None:
        """Tell the user of an index that is not the configured one, or that others do not try."""
        wanted = self._settings.index
        if wanted not in (None, index):
            # With -m auto this process has a participant of Cyclone, too.
            self.notices.append(
                f"domain {domain}: the participant index {wanted} of CYCLONEDDS_URI is taken, so"
                f" {index} is used"
            )
        if index >= network.PROBED and not self._settings.multicast:
            self.notices.append(
                f"domain {domain}: this is participant {index} of this machine, and without"
                f" multicast others look for participants 0 to {network.PROBED - 1}: those"
                " beyond are not found by all; end others, or use another domain"
            )

    def _open_at(self, domain: int, port: int) -> bool:
        """Open the sockets of all versions of IP at a port; return False if it is taken."""
        data_port = locators.data_port(port)
        for kind in self._settings.kinds:
            try:
                opened = IpSockets(kind, port, data_port, self._settings.stays_local)
            except OSError as error:
                self.close()
                if error.errno == errno.EADDRINUSE:
                    return False
                raise MiddlewareError(f"domain {domain}: {_fault(kind, port, error)}") from error
            self._sockets[kind] = opened
            port, data_port = opened.port, opened.data_port
        return True

    def _check_choices(self) -> None:
        """Tell the user of interfaces in CYCLONEDDS_URI that are not there."""
        known = {text for one in self._interfaces for text in (one.name, one.address, *one.ipv6)}
        missing = [one.name for one in self._settings.choices if one.name not in known]
        if missing and sys.platform != "linux":
            there = ", ".join(one.address for one in _one_interface())
            self.notices.append(
                f"CYCLONEDDS_URI asks for the interface {', '.join(missing)}, but uros does not"
                f" list its interfaces on this system and knows {there} alone: give one of these"
                " addresses instead, or leave it out"
            )
        elif missing:
            there = ", ".join(one.name for one in self._list_interfaces()) or "none"
            self.notices.append(
                f"CYCLONEDDS_URI asks for the interface {', '.join(missing)}, which is not up with"
                f" an address (there are {there}): it is used once it is"
            )

    # --- interfaces ------------------------------------------------------------------------------

    def scan(self, now: float) -> bool:
        """Look at the interfaces; return whether :attr:`unicast` or :attr:`multicast` changed."""
        if not self._sockets:
            return False
        self.scan_at = now + SCAN_PERIOD
        self._scanned_at = now
        try:
            found = self._list_interfaces() or _one_interface()
        except OSError:  # no descriptor is free now
            return False
        self._interfaces = self._settings.usable(found)
        with_multicast = [one for one in self._interfaces if self._settings.allows_multicast(one)]
        for each in self._sockets.values():
            each.join(with_multicast)
        before = self.unicast, self.multicast
        ports = next(iter(self._sockets.values()))
        kinds, size = list(self._sockets), self._settings.message_size
        self.unicast = network.announced(self._interfaces, kinds, ports.port, size)
        self.data = network.announced(self._interfaces, kinds, ports.data_port, size)
        self.multicast = [place for each in self._sockets.values() for place in each.groups]
        return (self.unicast, self.multicast) != before

    # --- datagrams -------------------------------------------------------------------------------

    def filenos(self) -> list[int]:
        """Return the descriptors that are readable when datagrams have come, samples last.

        One of them tells that interfaces have changed.
        """
        return [*([] if self._changes is None else [self._changes.fileno()]), *self._receiving]

    def is_for_samples(self, fileno: int) -> bool:
        """Return whether a descriptor is that of a port for samples, and not for discovery."""
        return fileno in self._for_samples

    def receive(self, fileno: int, most: int = MAX_BURST) -> Iterator[tuple[memoryview, str]]:
        """Yield datagrams that have come to a descriptor, with the addresses of their senders.

        A datagram is valid until the next one. At most ``most`` are taken; the rest leaves the
        descriptor readable. A link-local address has the number of its interface, see
        :class:`Locator`.
        """
        if fileno not in self._receiving:
            self._take_changes()
            return
        kind, sock = self._receiving[fileno]
        for count in range(most):
            if count == 1 and not has_input(fileno):
                break
            try:
                size, source = sock.recvfrom_into(self._buffer)
            except BlockingIOError:
                break
            except OSError:
                continue  # an ICMP error of a datagram sent earlier
            if kind == UDPV6:
                yield self._view[:size], locators.scoped(source[0], source[3])
            else:
                yield self._view[:size], source[0]

    def _take_changes(self) -> None:
        """Have the interfaces looked at soon."""
        assert self._changes is not None
        self.scan_at = self._scanned_at + _SCAN_PAUSE
        for _ in range(MAX_BURST):
            try:
                self._changes.recv(_LARGEST)
            except BlockingIOError:
                break
            except OSError:
                continue  # there were more than its buffer holds

    def send(self, datagram: bytes, place: Locator) -> bool:
        """Send a datagram.

        Returns:
            False where the system has no room now: send it again later. What cannot be sent at all
            is counted in :attr:`send_errors`, and lost as on a network.
        """
        each = self._sockets.get(place.kind)
        if each is None:
            if self._sockets:  # else the range is OFF
                self.send_errors[errno.EAFNOSUPPORT] += 1
            return True
        try:
            each.send(datagram, place)
        except BlockingIOError:
            return False
        except OSError as error:
            self.send_errors[error.errno or 0] += 1
            if error.errno in _UNREACHABLE and not place.is_multicast:
                self.unreachable.add(place.address)
        return True

    def close(self) -> None:
        """Close the sockets; idempotent."""
        for each in self._sockets.values():
            each.close()
        self._sockets.clear()
        if self._changes is not None:
            self._changes.close()
            self._changes = None
        self._receiving.clear()
        self.scan_at = None


def _fault(kind: int, port: int, error: OSError) -> str:
    if kind == UDPV6 and error.errno in (errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL):
        return (
            f"this machine has no IPv6 ({error.strerror}): turn it on, or take IPv6 out of"
            " CYCLONEDDS_URI and ROS_STATIC_PEERS"
        )
    return f"UDP port {port}: {error}"


def _one_interface() -> list[Interface]:
    """The interface towards the network, on systems that do not list theirs."""
    found = []
    flags = addresses.UP | addresses.RUNNING | addresses.MULTICAST
    group = (locators.MULTICAST_GROUPS[UDPV4][0], locators.multicast_port(0))
    address = addresses.own_address(group)
    if address is not None and not address.startswith("127."):
        found.append(Interface("default", 0, flags, address))
    loopback = addresses.UP | addresses.RUNNING | addresses.LOOPBACK
    found.append(Interface("lo0", 1, loopback, "127.0.0.1", ("::1",)))
    return found
